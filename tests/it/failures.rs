//! Blocks that cannot be made: written down, reproduced alone, and no end without an address.

use serde_json::Value;
use tests::{Run, assert_nothing_left, octopus, python, stderr};

/// What a failed run left about a block.
fn failure(run: &Run, directory: &str) -> Value {
    let path = run.path().join("failures").join(directory).join("failure.json");
    let text = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_slice(&text).expect("JSON")
}

#[test]
fn a_shard_that_crashes_its_worker_three_times_stops_the_run_with_its_address() {
    let mut run = Run::with_variables(&[("SPACEOCTOPUS_TEST_FAULT", "crash@7/2")]);
    run.start_training(&["--workers=2", "--overlap=1", "--iterations=40"]);
    let domain = run.domain_when_there();
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    assert_nothing_left(&domain);
    let log = run.log();
    assert!(log.contains("seed 7, iteration 7, shard 2 failed 3 times"), "{log}");
    assert!(log.contains("octopus rollout") && log.contains("--address 7/7/2"), "{log}");
    let report = failure(&run, "iteration-00000007-shard-2");
    assert_eq!((&report["attempts"], &report["policy_version"]), (&3.into(), &6.into()));

    // The command that the message names makes the block alone: without the fault it can be made,
    // with the very policy of the run, and twice the same.
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let out = run.path().with_file_name("block.safetensors");
    let make = || {
        let out = out.to_str().expect("UTF-8");
        let made =
            octopus(&["rollout", path, "--address", "7/7/2", "--out", out, "--force", "--json"]);
        assert!(made.status.success(), "{}", stderr(&made));
        serde_json::from_slice::<Value>(&made.stdout).expect("JSON")
    };
    let (first, second) = (make(), make());
    assert!(first["policy"].as_str().expect("text").contains("failures"), "{first}");
    assert_eq!(first["blake3"], second["blake3"]);
    let script = "import sys, safetensors.numpy as st\n\
                  t = st.load_file(sys.argv[1])\n\
                  assert t['action'].shape == (8, 8, 4, 3), t['action'].shape\n";
    let read = std::process::Command::new(python()).args(["-c", script]).arg(&out).output();
    let read = read.expect("python starts");
    assert!(read.status.success(), "{}", stderr(&read));

    // Without the fault the run goes on, and ends as if nothing had been.
    run.forget_variables();
    run.resume(&[]);
    run.succeed();
    let mut calm = Run::train(&["--workers=1", "--overlap=1", "--iterations=40"]);
    calm.succeed();
    assert_eq!(run.digests(), calm.digests());
}

#[test]
fn a_shard_that_hangs_is_killed_at_its_deadline_and_stops_the_run_the_third_time() {
    let mut run = Run::with_variables(&[("SPACEOCTOPUS_TEST_FAULT", "hang@5/1")]);
    let deadline = "--set=run.order_deadline_s=1.5";
    run.start_training(&["--workers=2", "--iterations=40", deadline]);
    let domain = run.domain_when_there();
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    assert_nothing_left(&domain);
    assert!(run.log().contains("has been silent for 1.5 s"), "{}", run.log());
    assert!(run.log().contains("iteration 5, shard 1 failed 3 times"), "{}", run.log());
}

#[test]
fn a_simulation_that_diverges_is_caught_with_its_environment() {
    // Half a second of semi-implicit Euler with stiff servos is beyond its stability.
    let mut run = Run::train(&[
        "--workers=2",
        "--iterations=40",
        "--set=env.integrator=euler",
        "--set=env.substep=0.4",
        "--set=task.action_scale=3.0",
    ]);
    let domain = run.domain_when_there();
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    assert_nothing_left(&domain);
    let log = run.log();
    assert!(log.contains("the simulation has diverged"), "{log}");
    let found = std::fs::read_dir(run.path().join("failures")).expect("failures").flatten();
    let names: Vec<_> =
        found.map(|entry| entry.file_name().into_string().expect("UTF-8")).collect();
    assert!(!names.is_empty());
    let report = failure(&run, &names[0]);
    let environment = &report["environment"];
    for (array, len) in [("joint_angles_rad", 24), ("base_position_m", 3), ("command_rad_s", 24)] {
        let values = environment[array].as_array().unwrap_or_else(|| panic!("{array}: {report}"));
        assert_eq!(values.len(), len);
        assert!(values.iter().all(|value| value.as_f64().is_some_and(f64::is_finite)), "{report}");
    }
    let address = format!("7/{}/{}", report["iteration"], report["shard"]);
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let again = octopus(&["rollout", path, "--address", &address, "--json"]);
    assert_eq!(again.status.code(), Some(6), "{}", stderr(&again));
    let again: Value = serde_json::from_slice(&again.stdout).expect("JSON");
    assert_eq!(&again["environment"], environment, "the same moment, alone");
}

/// Gradients may be finite and lead to what is not. Workers that refused such a policy once waited for another one without end.
#[test]
fn a_training_whose_deviations_explode_ends_and_nobody_gets_to_see_them() {
    let settings = [
        "algorithm.max_kl=0",
        "algorithm.entropy_coefficient=100",
        "algorithm.epochs=10",
        "optimizer.actor_lr=10",
        "optimizer.schedule=constant",
        "run.checkpoint_every=1",
    ];
    let mut words = vec!["--workers=1".to_owned(), "--iterations=20".to_owned()];
    words.extend(settings.map(|setting| format!("--set={setting}")));
    let mut run = Run::train(&words.iter().map(String::as_str).collect::<Vec<_>>());
    let domain = run.domain_when_there();
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    assert_nothing_left(&domain);
    let log = run.log();
    assert!(log.contains("holds deviations beyond all numbers after iteration"), "{log}");
    assert!(log.contains("lower the learning rate"), "{log}");
}
