//! Recordings and robot descriptions, as readers of others see them.

use std::process::Command;

use serde_json::{Value, json};
use tests::guide::repository;
use tests::{Run, crosscheck, octopus, python, stderr};

/// Has others read a recording and its columns beside the robot's description; what they say.
pub(crate) fn read_by_others(mcap: &str, csv: &str, urdf: &str) -> String {
    let output = Command::new(python())
        .arg(crosscheck("recording.py"))
        .args([mcap, csv, urdf])
        .output()
        .expect("Python can be started");
    assert!(output.status.success(), "{mcap}: {}", stderr(&output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn a_recording_is_read_by_others_and_agrees_with_the_robots_description() {
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).display().to_string();
    let urdf = octopus(&["urdf", "--robot", "paper", "--out", &at("robot.urdf")]);
    assert!(urdf.status.success(), "{}", stderr(&urdf));
    for (task, steps) in [("trajectory", "60"), ("reorientation", "20")] {
        let policy = repository().join("deploy/policies").join(task).display().to_string();
        let (mcap, csv) = (at(&format!("{task}.mcap")), at(&format!("{task}.csv")));
        let args = ["record", &policy, "--out", &mcap, "--csv", &csv, "--steps", steps];
        let made = octopus(&args);
        assert!(made.status.success(), "{}", stderr(&made));
        let said = read_by_others(&mcap, &csv, &at("robot.urdf"));
        assert!(said.contains("frames"), "{said}");
        // The same episode is the same file, and takes the place of the one before.
        let before = std::fs::read(&mcap).expect("there");
        assert!(octopus(&args).status.success());
        assert!(std::fs::read(&mcap).expect("there") == before, "{task}");
        let again = octopus(&["replay", &mcap]);
        assert!(again.status.success(), "{}", stderr(&again));
        let said = String::from_utf8_lossy(&again.stdout).into_owned();
        assert!(said.contains("the same, all") && said.contains(steps), "{said}");
    }
    let policy = repository().join("deploy/policies/trajectory").display().to_string();
    let csv = at("trajectory.csv");
    let whole = std::fs::read(at("trajectory.mcap")).expect("recorded");
    std::fs::write(at("cut.mcap"), &whole[..whole.len() / 2]).expect("written");
    for (args, code, said) in [
        (vec!["replay", &at("cut.mcap")], 3, "is cut off or damaged"),
        (vec!["record", &policy, "--out", &csv], 5, "is there already"),
        (vec!["record", &policy, "--out", &at("x"), "--csv", &at("x")], 2, "is what --out writes"),
        (vec!["record", &policy, "--out", &at("x"), "--steps", "0"], 2, "whole number"),
        (vec!["record", "--out", &at("x")], 2, "RUN_DIR|CHECKPOINT"),
        (vec!["record", &policy, "--plan", &csv, "--out", &at("x")], 2, "cannot be used with"),
        (vec!["record", &policy, "--env", "1", "--out", &at("x")], 2, "--address"),
        (vec!["record", "--plan", &at("nothing"), "--out", &at("x")], 3, "nothing"),
        (vec!["replay", &at("nothing")], 3, "cannot be read"),
        (vec!["replay", &csv], 3, "no recording (MCAP) and no block"),
        (vec!["replay", &at("robot.urdf")], 3, "no recording (MCAP) and no block"),
        (vec!["record", &at("nothing"), "--out", &at("x")], 5, "nothing"),
        (vec!["urdf", "--robot", "octopod"], 3, "octopod"),
        (vec!["urdf", "--robot", "paper", "--out", &csv], 5, "is there already"),
    ] {
        let refused = octopus(&args);
        assert_eq!(refused.status.code(), Some(code), "{args:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{args:?}: {}", stderr(&refused));
    }
}

#[test]
fn a_plan_is_recorded_and_played_again() {
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).display().to_string();
    let goal = ["--by", "--goal=1=0.1,0,-0.2,0,0,0.2", "--time-limit=60s"];
    let outputs = ["--out", &at("plan.csv"), "--recording", &at("with_goals.mcap")];
    let plan = octopus(&[&["plan"], &goal[..], &outputs, &["--trajectory", &at("t.csv")]].concat());
    assert!(plan.status.success(), "{}", stderr(&plan));
    let record = ["record", "--plan", &at("plan.csv"), "--out", &at("plan.mcap"), "--csv"];
    let record = octopus(&[&record[..], &[&at("columns.csv")]].concat());
    assert!(record.status.success(), "{}", stderr(&record));
    for file in ["plan.mcap", "with_goals.mcap"] {
        let again = octopus(&["replay", &at(file), "--json"]);
        assert!(again.status.success(), "{}", stderr(&again));
        let said: Value = serde_json::from_slice(&again.stdout).expect("JSON");
        assert_eq!((&said["kind"], &said["same"]), (&json!("recording"), &json!(true)), "{said}");
    }
    // The plan's motion is that of `octopus simulate`, whose table the planner writes.
    let last = |name: &str, column: &str| {
        let table = std::fs::read_to_string(at(name)).expect("a table");
        let header = table.lines().next().expect("a header");
        let index = header.split(',').position(|name| name == column).expect("the column");
        let last = table.lines().last().expect("a row");
        last.split(',').nth(index).expect("a cell").to_owned()
    };
    for (recorded, simulated) in [("base_x", "base_x"), ("base_qz", "base_qz")] {
        assert_eq!(last("columns.csv", recorded), last("t.csv", simulated));
    }
}

#[test]
fn a_block_is_recorded_and_played_again() {
    let mut run = Run::train(&["--workers=1", "--iterations=4", "--set=run.checkpoint_every=2"]);
    run.succeed();
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).display().to_string();
    let path = run.path().display().to_string();
    let block = ["rollout", &path, "--address=7/2/1", "--out", &at("block.safetensors")];
    let block = octopus(&block);
    assert!(block.status.success(), "{}", stderr(&block));
    let record = ["record", &path, "--address=7/2/1", "--env=3", "--out", &at("block.mcap")];
    let record = octopus(&record);
    assert!(record.status.success(), "{}", stderr(&record));
    for (file, kind) in [("block.safetensors", "block"), ("block.mcap", "recording")] {
        let again = octopus(&["replay", &at(file)]);
        assert!(again.status.success(), "{file}: {}", stderr(&again));
        let said = String::from_utf8_lossy(&again.stdout).into_owned();
        assert!(said.starts_with(&format!("{kind}: the same")), "{said}");
    }
    // Another reward: the answer is no, and says where.
    let script = "import sys, safetensors, safetensors.numpy as st\n\
                  path = sys.argv[1]\n\
                  about = safetensors.safe_open(path, 'np').metadata()\n\
                  t = st.load_file(path)\n\
                  t['reward'] = t['reward'].copy()\n\
                  t['reward'][2, 5, 1] += 1\n\
                  st.save_file(t, path, metadata=about)\n";
    let changed = std::process::Command::new(python())
        .args(["-c", script, &at("block.safetensors")])
        .output()
        .expect("python starts");
    assert!(changed.status.success(), "{}", stderr(&changed));
    let again = octopus(&["replay", &at("block.safetensors")]);
    assert_eq!(again.status.code(), Some(1), "{}", stderr(&again));
    let said = String::from_utf8_lossy(&again.stdout).into_owned();
    assert!(said.contains("control step 6 of 8"), "{said}");
    assert!(said.contains("environment 1, agent 2: reward"), "{said}");
    for (args, code, words) in [
        (["record", &path, "--address=7/2/9", "--out", &at("x")], 2, "no shard 9"),
        (["record", &path, "--address=7/2", "--out", &at("x")], 2, "SEED/ITERATION/SHARD"),
        (["record", &path, "--address=7/3/1", "--out", &at("x")], 5, "was not kept"),
    ] {
        let refused = octopus(&args);
        assert_eq!(refused.status.code(), Some(code), "{args:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(words), "{args:?}: {}", stderr(&refused));
    }
    let beyond = ["record", &path, "--address=7/2/1", "--env=99", "--out", &at("x")];
    let beyond = octopus(&beyond);
    assert_eq!(beyond.status.code(), Some(2));
    assert!(stderr(&beyond).contains("--env 99"), "{}", stderr(&beyond));
}
