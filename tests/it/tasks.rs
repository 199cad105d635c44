//! Tasks beside the paper's: they train to the same bits whatever the workers, are evaluated, shown, exported and recorded, and refused where they have no
//! place.

use std::path::PathBuf;

use serde_json::Value;
use tests::{Run, WITH_POSTURES, octopus, stderr};

use crate::export::{check_c, check_onnx};
use crate::record::read_by_others;

/// A run of three iterations, each with a checkpoint.
fn trained(task: &str, workers: &str, more: &[&str]) -> Run {
    let mut run = Run::new();
    let always = ["--iterations=3", "--set=run.checkpoint_every=1", workers];
    run.start_training_of(task, &[&always[..], more].concat());
    run.succeed();
    run
}

/// What `octopus eval` finds over three episodes.
fn evaluated(run: &Run) -> Value {
    let path = run.path().display().to_string();
    let output = octopus(&["eval", &path, "--episodes=3", "--steps=20", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// The errors of a summary's list, by name.
fn names(list: &Value) -> Vec<&str> {
    let all = list.as_array().expect("a list").iter();
    all.map(|error| error["error"].as_str().expect("a name")).collect()
}

/// Makes a film, a controller and recordings of it.
fn shown_exported_and_recorded(run: &Run) {
    let (path, place) = (run.path().display().to_string(), tempfile::tempdir().expect("tempdir"));
    let at = |name: &str| place.path().join(name).display().to_string();
    let succeeds = |args: &[&str]| {
        let output = octopus(args);
        assert!(output.status.success(), "{args:?}: {}", stderr(&output));
        String::from_utf8(output.stdout).expect("UTF-8")
    };
    succeeds(&["film", &path, "--out", &at("film.gif"), "--steps=5", "--size=64x48", "--fps=5"]);
    assert!(std::fs::metadata(at("film.gif")).expect("a film").len() > 500);

    succeeds(&["export", &path, "--out", &at("controller"), "--episodes=1"]);
    check_c(&place.path().join("controller"), &["-O1"]);
    check_onnx(&[PathBuf::from(at("controller"))]);

    // An episode, and an environment of a block: of the first checkpoint, as a disk that is slower than the training leaves others out.
    succeeds(&["urdf", "--robot=paper", "--out", &at("robot.urdf")]);
    for (name, of) in [("episode", "--steps=20"), ("block", "--address=7/1/1")] {
        let [mcap, csv] = ["mcap", "csv"].map(|ending| at(&format!("{name}.{ending}")));
        succeeds(&["record", &path, "--out", &mcap, "--csv", &csv, of]);
        read_by_others(&mcap, &csv, &at("robot.urdf"));
        let said = succeeds(&["replay", &mcap]);
        assert!(said.contains("the same, all"), "{name}: {said}");
    }
}

#[test]
fn a_body_is_captured_to_the_same_bits() {
    let one = trained("capture", "--workers=1", WITH_POSTURES);
    let two = trained("capture", "--workers=2", WITH_POSTURES);
    assert_eq!(one.digests(), two.digests());
    let found = evaluated(&one);
    assert_eq!(names(&found["overall"]), ["position", "orientation"]);
    let held = &found["held"];
    let share = held["episodes"].as_f64().expect("a share");
    assert!((0.0..=1.0).contains(&share) && held["untouched"].as_f64() <= Some(share), "{held}");
    for episode in found["episodes"].as_array().expect("episodes") {
        assert!(episode["held"]["longest"].as_u64() <= Some(20), "{episode}");
    }
    assert!(found["reachable"].is_null(), "goals that move are not looked for one by one");
    shown_exported_and_recorded(&one);
}

#[test]
fn half_of_the_arms_reach_while_the_others_turn() {
    let one = trained("mixed", "--workers=1", &[]);
    let two = trained("mixed", "--workers=2", &[]);
    assert_eq!(one.digests(), two.digests());
    let found = evaluated(&one);
    assert_eq!(names(&found["overall"]), ["position", "orientation", "base"]);
    // Two arms that reach have two agents each; the others all answer for the base.
    assert_eq!(names(&found["agents"]), ["position", "orientation"].repeat(2));
    assert!(found["held"].is_null());
    shown_exported_and_recorded(&one);
}

#[test]
fn a_task_for_two_arms_is_refused_on_a_robot_with_one() {
    let robots =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../sim-worker/simulator/robots/two-arm.toml");
    let two = std::fs::read_to_string(robots).expect("it is there");
    let at = two.rfind("[[arms]]").expect("two arms");
    let place = tempfile::tempdir().expect("tempdir");
    let robot = place.path().join("one.toml");
    std::fs::write(&robot, &two[..at]).expect("room");
    let (runs, robot) = (place.path().join("run"), robot.display().to_string());
    let (out, set) =
        (format!("--run-dir={}", runs.display()), format!("--set=robot.description={robot}"));
    let output = octopus(&["train", "mixed", &out, &set, "--iterations=1"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let said = stderr(&output);
    assert!(said.contains("has 1 arm, and task `mixed` needs 2"), "{said}");
    assert!(!runs.exists(), "nothing is left of it");
}
