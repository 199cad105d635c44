//! Robots whose arms differ: they learn to the same bits whatever the workers, and everything that shows or moves a robot takes them.

use serde_json::Value;
use tests::{Run, WITH_POSTURES, octopus, stderr};

use crate::export::{check_c, check_onnx};
use crate::machines::{Machine, free_endpoint, hold, open, wait_for};
use crate::record::read_by_others;

/// Arms of six, six, seven and seven joints.
const ROBOT: &str = concat!(
    "--robot=",
    env!("CARGO_MANIFEST_DIR"),
    "/../sim-worker/simulator/robots/seven-joints.toml"
);

/// A run of three iterations.
fn trained(task: &str, more: &[&str]) -> Run {
    let mut run = Run::new();
    run.start_training_of(task, &[&["--iterations=3", ROBOT], more].concat());
    run.succeed();
    run
}

#[test]
fn arms_that_differ_learn_to_the_same_bits() {
    for (task, more) in [
        ("trajectory", WITH_POSTURES),
        ("reorientation", &["--set=algorithm.name=maddpg"][..]),
        ("trajectory", &["--set=algorithm.name=ppo"]),
        ("mixed", &["--set=algorithm.name=ippo"]),
    ] {
        let [one, two] = ["--workers=1", "--workers=2"]
            .map(|workers| trained(task, &[&[workers], more].concat()));
        assert_eq!(one.digests(), two.digests(), "{task} {more:?}");
    }
}

#[test]
fn other_machines_help_with_them() {
    let iterations = "--iterations=20";
    let mut calm = Run::train(&[ROBOT, "--workers=2", iterations]);
    calm.succeed();
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &[ROBOT, "--workers=1", iterations]);
    let learner = hold(&mut run);
    run.domain_when_there();
    let mut helper = Machine::join(&endpoint, &["--workers=2"]);
    wait_for(&mut run, "helps with 2 workers", 1);
    tests::kill(learner, rustix::process::Signal::CONT);
    run.succeed();
    helper.succeed();
    assert_eq!(run.digests(), calm.digests());
}

#[test]
fn their_policies_are_evaluated_shown_recorded_and_exported() {
    let every = ["--set=run.checkpoint_every=1"];
    let run = trained("trajectory", &[WITH_POSTURES, &every].concat());
    let path = run.path().display().to_string();
    let place = tempfile::tempdir().expect("a directory");
    let at = |name: &str| place.path().join(name).display().to_string();
    let succeeds = |args: &[&str]| {
        let output = octopus(args);
        assert!(output.status.success(), "{args:?}: {}", stderr(&output));
        output.stdout
    };
    let evaluate = |more: &[&str]| -> Value {
        let args = [&["eval", "--episodes=3", "--steps=10", "--json"], more].concat();
        serde_json::from_slice(&succeeds(&args)).expect("JSON")
    };
    for found in [evaluate(&[&path]), evaluate(&["--controller=jacobian", ROBOT])] {
        let episodes = found["episodes"].as_array().expect("episodes");
        assert!(episodes.iter().all(|one| one["hands"].as_array().map(Vec::len) == Some(4)));
    }
    succeeds(&["film", &path, "--out", &at("film.gif"), "--steps=5", "--size=64x48", "--fps=5"]);
    succeeds(&["urdf", ROBOT, "--out", &at("robot.urdf")]);
    let (mcap, csv) = (at("motion.mcap"), at("motion.csv"));
    succeeds(&["record", &path, "--out", &mcap, "--csv", &csv, "--steps=20"]);
    read_by_others(&mcap, &csv, &at("robot.urdf"));
    let said = String::from_utf8(succeeds(&["replay", &mcap])).expect("UTF-8");
    assert!(said.contains("the same, all"), "{said}");
    let block = at("block.safetensors");
    succeeds(&["rollout", &path, "--address=7/1/1", "--out", &block]);
    let said = String::from_utf8(succeeds(&["replay", &block])).expect("UTF-8");
    assert!(said.contains("the same"), "{said}");
    // A hand of seven joints goes where it is told, the base turning back.
    let plan = ["plan", ROBOT, "--by", "--goal=3=0.05,0.05,-0.1,0.1,0,0", "--json"];
    let plan: Value = serde_json::from_slice(&succeeds(&plan)).expect("JSON");
    assert!(plan.is_object());

    succeeds(&["export", &path, "--out", &at("controller"), "--episodes=1"]);
    check_c(&place.path().join("controller"), &["-O1"]);
    check_onnx(&[place.path().join("controller")]);

    for (args, code, words) in [
        (vec!["eval", &path, "--robot=paper", "--episodes=1"], 2, "--robot"),
        (
            vec!["experiment", "precision", "--trajectory", &path, "--robot=paper", "--episodes=1"],
            3,
            "the policy moves arms of 6, 6, 7, 7 joints, the robot `paper` has 4 arms of 6 joints",
        ),
    ] {
        let refused = octopus(&args);
        assert_eq!(refused.status.code(), Some(code), "{args:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(words), "{args:?}: {}", stderr(&refused));
    }
}
