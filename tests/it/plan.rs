//! `octopus plan`: its plans played by `octopus simulate` and by MuJoCo, and what it refuses.

use std::path::Path;
use std::process::Command;

use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};
use simulator::robot::Robot;
use simulator::state::State;
use tests::{crosscheck, octopus, python, stderr};

/// Long enough on any machine: the limit only says when to give up.
const PATIENT: &str = "--time-limit=5m";

fn path(dir: &Path, name: &str) -> String {
    dir.join(name).display().to_string()
}

/// A goal that the hand of arm 2 reaches, and one for arm 4.
const GOALS: [&str; 2] = ["--goal=2=0.4,-1.1,4.2,1.6,0,1.5", "--goal=4=0.15,0.05,3.1,3.0,0.1,0.1"];

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|x| x.as_f64().expect("a number")).collect()
}

/// MuJoCo integrates its own model of the robot in steps of 1 ms, so it ends a little elsewhere.
#[test]
fn a_plan_ends_where_it_says_in_simulate_and_in_mujoco() {
    let dir = tempfile::tempdir().expect("tempdir");
    let [plan, motion, again, picture, model, home] =
        ["plan.csv", "motion.csv", "again.csv", "plan.svg", "robot.xml", "home.json"]
            .map(|name| path(dir.path(), name));
    let [out, trajectory, drawn] = [("out", &plan), ("trajectory", &motion), ("picture", &picture)]
        .map(|(flag, path)| format!("--{flag}={path}"));
    let flags = ["plan", PATIENT, &out, &trajectory, &drawn, "--json"];
    let output = octopus(&[&flags[..], &GOALS].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let said: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!(said["reached"], true);
    assert_eq!(said["contact_steps"], 0);
    let hands = said["hands"].as_array().expect("a list");
    assert_eq!(hands.iter().map(|hand| &hand["hand"]).collect::<Vec<_>>(), [&json!(2), &json!(4)]);

    let simulated = octopus(&["simulate", "--robot=paper", "--actions", &plan, "--out", &again]);
    assert!(simulated.status.success(), "{}", stderr(&simulated));
    let [motion, again] = [&motion, &again].map(|path| std::fs::read(path).expect("written"));
    assert!(motion == again, "octopus simulate ends elsewhere");
    let drawn = std::fs::read_to_string(&picture).expect("written");
    assert!(drawn.contains("hand 2") && drawn.contains("near enough"));

    let made = octopus(&["mjcf", "--robot=paper", "--out", &model]);
    assert!(made.status.success(), "{}", stderr(&made));
    let start = State::<f64>::home(&Robot::builtin("paper").expect("built in"));
    let qpos: Vec<f64> =
        start.base_position.iter().chain(&start.base_quaternion).chain(&start.q).copied().collect();
    std::fs::write(&home, json!(qpos).to_string()).expect("writable");
    let output =
        Command::new(python()).arg(crosscheck("plan.py")).args([&model, &home, &plan]).output();
    let output = output.expect("Python starts");
    assert!(output.status.success(), "{}", stderr(&output));
    let played: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!(played["contacts"], 0, "nothing touches there, either");
    for hand in hands {
        let arm = hand["hand"].as_u64().expect("a number") as usize - 1;
        let goal = numbers(&hand["goal"]);
        let there = &played["hands"][arm];
        let place = Vector3::from_vec(numbers(&there["position"]));
        let off = (place - Vector3::new(goal[0], goal[1], goal[2])).norm();
        let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
        let wanted = about(Vector3::x_axis(), goal[3])
            * about(Vector3::y_axis(), goal[4])
            * about(Vector3::z_axis(), goal[5]);
        let [w, x, y, z] = numbers(&there["quaternion"])[..] else { panic!("four numbers") };
        let found = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let turned = UnitQuaternion::from(wanted).angle_to(&found);
        assert!(off < 5e-3 && turned < 10e-3, "{there}: {off} m, {turned} rad off");
    }
}

#[test]
fn a_plan_begins_where_another_motion_ended_and_is_the_same_again() {
    let dir = tempfile::tempdir().expect("tempdir");
    let [first, second, third, before] =
        ["first.csv", "second.csv", "third.csv", "before.csv"].map(|name| path(dir.path(), name));
    let there = ["plan", PATIENT, GOALS[0], "--out", &first, "--trajectory", &before];
    assert!(octopus(&there).status.success());
    let back = "--goal=2=0,0,0.1,0,0,0";
    for out in [&second, &third] {
        let flags = ["plan", PATIENT, "--by", "--frame=mount", back, "--state", &before];
        let output = octopus(&[&flags[..], &["--out", out]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let [first, second, third] =
        [&first, &second, &third].map(|path| std::fs::read(path).expect("written"));
    assert_eq!(second, third);
    assert_ne!(first, second);
}

#[test]
fn a_policys_own_motion_is_taken_where_it_arrives() {
    let policy = format!("{}/../deploy/policies/trajectory", env!("CARGO_MANIFEST_DIR"));
    let flags = ["plan", PATIENT, "--by", "--goal=3=0.05,0,-0.25,0.7,0.1,0", "--within=2cm,60mrad"];
    let output = octopus(&[&flags[..], &["--policies", &policy, "--json"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let said: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!((&said["by_policy"], &said["reached"]), (&json!(true), &json!(true)), "{said}");
    assert!(said["candidates"].as_u64().is_some_and(|tried| tried <= 2), "{said}");
}

#[test]
fn what_cannot_be_reached_ends_with_a_reason_and_no_file() {
    let dir = tempfile::tempdir().expect("tempdir");
    let plan = path(dir.path(), "plan.csv");
    for (goal, reason) in [
        ("--goal=1=0.3,4.2,4.3,0,0,0", "no joint angles bring hand 1"),
        // None was played.
        ("--goal=1=0.3,4.2,4.3,0,0,0", ". At the start it misses hand 1 by "),
        // In the middle of the base.
        ("--goal=1=0,0,4,0,0,0", "no plan within"),
    ] {
        let output = octopus(&["plan", "--time-limit=1ms", goal, "--out", &plan]);
        assert_eq!(output.status.code(), Some(1));
        assert!(stderr(&output).contains(reason), "{}", stderr(&output));
        assert!(!Path::new(&plan).exists());
    }
}

#[test]
fn bad_questions_are_refused() {
    let dir = tempfile::tempdir().expect("tempdir");
    let bad = path(dir.path(), "bad.csv");
    std::fs::write(&bad, "t,base_x\n0,1\n").expect("writable");
    let base_policy = format!("{}/../deploy/policies/reorientation", env!("CARGO_MANIFEST_DIR"));
    let goal = GOALS[0];
    for (flags, code, reason) in [
        (&["plan"][..], 2, "--goal"),
        (&["plan", "--goal=5=0,0,4,0,0,0"], 2, "has 4 hands"),
        (&["plan", goal, goal], 2, "given twice"),
        (&["plan", "--goal=2=0,0,4"], 2, "six numbers"),
        (&["plan", goal, "--within=5,10"], 2, "5mm,10mrad"),
        (&["plan", goal, "--robot=none.toml"], 3, "none.toml"),
        (&["plan", goal, "--state", &bad], 3, "expected the 75 columns"),
        (&["plan", goal, "--policy", &base_policy], 2, "`trajectory`"),
        (&["plan", goal, "--out", &bad, "--state", &bad], 2, "is what --state reads"),
        (&["plan", "--held-out=3", goal], 2, "cannot be used with"),
        (&["plan", goal, "--json", "--trajectory=/no/such/x.csv"], 1, "cannot be written"),
        (&["plan", goal, "--policy=none", "--out=/proc/x.csv"], 1, "--out /proc/x.csv: cannot be"),
    ] {
        let output = octopus(flags);
        assert_eq!(output.status.code(), Some(code), "{flags:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(reason), "{flags:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty(), "{flags:?}");
    }
    let all: Vec<String> = (1..=4).map(|hand| format!("--goal={hand}=0,0,4,0,0,0")).collect();
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    let output = octopus(&[&["plan", "--hold-base"][..], &all].concat());
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("an arm without a goal"), "{}", stderr(&output));
}
