//! Recordings and robot descriptions, as readers of others see them.

use std::process::Command;

use tests::guide::repository;
use tests::{crosscheck, octopus, python, stderr};

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
        let output = Command::new(python())
            .arg(crosscheck("recording.py"))
            .args([&mcap, &csv, &at("robot.urdf")])
            .output()
            .expect("Python can be started");
        assert!(output.status.success(), "{task}: {}", stderr(&output));
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(said.contains("frames"), "{said}");
        // The same episode is the same file, and takes the place of the one before.
        let before = std::fs::read(&mcap).expect("there");
        assert!(octopus(&args).status.success());
        assert!(std::fs::read(&mcap).expect("there") == before, "{task}");
    }
    let policy = repository().join("deploy/policies/trajectory").display().to_string();
    let csv = at("trajectory.csv");
    for (args, code, said) in [
        (vec!["record", &policy, "--out", &csv], 5, "is there already"),
        (vec!["record", &policy, "--out", &at("x"), "--csv", &at("x")], 2, "is what --out writes"),
        (vec!["record", &policy, "--out", &at("x"), "--steps", "0"], 2, "whole number"),
        (vec!["record", &at("nothing"), "--out", &at("x")], 5, "nothing"),
        (vec!["urdf", "--robot", "octopod"], 3, "octopod"),
        (vec!["urdf", "--robot", "paper", "--out", &csv], 5, "is there already"),
    ] {
        let refused = octopus(&args);
        assert_eq!(refused.status.code(), Some(code), "{args:?}: {}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{args:?}: {}", stderr(&refused));
    }
}
