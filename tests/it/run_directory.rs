//! What a run leaves in its directory, read with the tools that a user would take.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::{Value, json};
use tests::{Run, assert_nothing_left, crosscheck, octopus, python, stderr};

#[test]
fn a_run_leaves_metrics_checkpoints_events_and_a_curve() {
    let mut run = Run::train(&[
        "--workers=2",
        "--iterations=6",
        "--set=run.evaluate_every=3",
        "--set=run.best_after=0",
        "--set=run.evaluation_episodes=3",
        "--set=run.evaluation_steps=4",
    ]);
    run.wait_for_iterations(1);
    let domain = run.domain();
    run.succeed();
    assert_nothing_left(&domain);

    let metrics = run.metrics();
    assert_eq!(metrics.len(), 6);
    for key in [
        "iteration",
        "env_steps",
        "digest",
        "wall_s",
        "env_steps_per_s",
        "returns",
        "kl",
        "clip_fraction",
        "entropy",
        "explained_variance",
        "accounting",
    ] {
        assert!(metrics[5].get(key).is_some(), "{key} is missing in {}", metrics[5]);
    }
    assert_eq!(metrics[5]["env_steps"], 6 * 16 * 8);
    assert_eq!(metrics[5]["returns"].as_array().map(Vec::len), Some(8));

    // The one after three iterations may have been overtaken, the last one never is.
    let text = std::fs::read_to_string(run.path().join("evaluations.jsonl")).expect("lines");
    assert!((1..=2).contains(&text.lines().count()), "once each: {text}");
    let last: Value = serde_json::from_str(text.lines().last().expect("a line")).expect("JSON");
    assert_eq!((&last["iteration"], &last["env_steps"]), (&json!(6), &json!(6 * 16 * 8)));
    assert_eq!((&last["episodes"], &last["steps"]), (&json!(3), &json!(4)));
    let error = |kind: &str, of: &str| last["errors"][kind][of].as_f64().expect("a number");
    for of in ["position", "orientation", "base"] {
        assert!(error("min", of) > 0.0 && error("min", of) <= error("tail", of), "{last}");
    }
    assert!(last["wall_s"].as_f64().expect("a number") > 0.0);

    let csv = std::fs::read_to_string(run.path().join("metrics.csv")).expect("a table");
    assert_eq!(csv.lines().count(), 7, "a header and six lines");
    let curve = std::fs::read_to_string(run.path().join("curve.svg")).expect("a picture");
    assert!(curve.contains("<svg"));
    for name in ["config.toml", "robot.toml", "provenance.json"] {
        assert!(run.path().join(name).is_file(), "{name}");
    }

    // Read by TensorBoard itself.
    let events = Command::new(python())
        .arg(crosscheck("read_events.py"))
        .arg(run.path().join("events"))
        .output()
        .expect("python starts");
    assert!(events.status.success(), "{}", stderr(&events));

    // Read from Python with safetensors alone.
    let script = "import sys, safetensors.numpy as st\n\
                  t = st.load_file(sys.argv[1])\n\
                  assert t['head.weight'].shape == (8, 16, 3), t['head.weight'].shape\n";
    let checkpoint = run.path().join("checkpoints/iteration-00000006/policy.safetensors");
    let read = Command::new(python()).args(["-c", script]).arg(checkpoint).output();
    let read = read.expect("python starts");
    assert!(read.status.success(), "{}", stderr(&read));
}

#[test]
fn a_dry_run_prints_a_configuration_that_gives_itself_and_trains_nothing() {
    let dir = tempfile::tempdir().expect("tempdir");
    let run_dir = format!("--run-dir={}", dir.path().join("run").display());
    let dry = |more: &[&str]| {
        let output = octopus(&[&["train", "--dry-run", &run_dir][..], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).expect("UTF-8")
    };
    let asked = ["reorientation", "--algorithm=ippo", "--set=task.reward.base.collision=3.5"];
    let text = dry(&asked);
    let table: toml::Table = text.parse().expect("TOML");
    assert_eq!(table["task"]["name"].as_str(), Some("reorientation"));
    assert_eq!(table["task"]["reward"]["base"]["collision"].as_float(), Some(3.5));
    let file = dir.path().join("my.toml");
    std::fs::write(&file, &text).expect("written");
    assert_eq!(dry(&[&format!("--config={}", file.display())]), text);
    let json: Value =
        serde_json::from_str(&dry(&[&asked[..], &["--json"]].concat())).expect("JSON");
    assert_eq!(json["algorithm"]["name"], "ippo");
    let open = octopus(&["train", "--dry-run", &run_dir, "--listen=0.0.0.0:0"]);
    assert_eq!(open.status.code(), Some(2), "{}", stderr(&open));
    assert!(stderr(&open).contains("--token-file"), "{}", stderr(&open));
    assert!(!dir.path().join("run").exists(), "something was begun");
}

#[test]
fn checkpoints_by_time_and_milestones_outlive_the_newest() {
    let mut run = Run::train(&[
        "--workers=2",
        "--iterations=100000",
        "--set=run.checkpoint_every=0",
        "--set=run.checkpoint_every_s=0.2",
        "--set=run.milestone_every_s=0.5",
        "--set=run.checkpoints_kept=1",
    ]);
    let names = || -> Vec<String> {
        let entries = std::fs::read_dir(run.path().join("checkpoints")).into_iter().flatten();
        let names = entries.flatten().map(|entry| entry.file_name().into_string().expect("UTF-8"));
        names.filter(|name| name.starts_with("iteration-")).collect()
    };
    // One milestone and one newer: without milestones there would never be two for long.
    let milestone = |name: &String| {
        let labels = run.path().join("checkpoints").join(name).join("labels.json");
        std::fs::read_to_string(labels).is_ok_and(|text| text.contains("\"milestone\": true"))
    };
    let watchdog = Instant::now() + Duration::from_mins(2);
    while names().iter().filter(|name| milestone(name)).count() < 2 {
        assert!(Instant::now() < watchdog, "{:?}; log:\n{}", names(), run.log());
        std::thread::sleep(Duration::from_millis(20));
    }
    run.signal(Signal::INT);
    run.succeed();
}

#[test]
fn a_disk_that_refuses_a_checkpoint_does_not_end_the_training() {
    let mut run = Run::train(&["--workers=2", "--iterations=100000"]);
    run.wait_for_iterations(7);
    // A file where the directory was: nothing can be written there, by nobody.
    let (path, aside) = (run.path().join("checkpoints"), run.path().join("aside"));
    std::fs::rename(&path, &aside).expect("renames");
    std::fs::write(&path, "no directory").expect("writes");
    let watchdog = Instant::now() + Duration::from_mins(2);
    while !run.log().contains("the training goes on without it") {
        assert!(Instant::now() < watchdog, "no warning; log:\n{}", run.log());
        std::thread::sleep(Duration::from_millis(20));
    }
    std::fs::remove_file(&path).expect("removes");
    std::fs::rename(&aside, &path).expect("renames");
    let done = run.metrics().len();
    run.wait_for_iterations(done + 12);
    run.signal(Signal::INT);
    run.succeed();
    let shown = run.path();
    let verified = octopus(&["checkpoints", "verify", shown.to_str().expect("UTF-8")]);
    assert!(verified.status.success(), "{}", stderr(&verified));
}

#[test]
fn an_evaluation_reads_a_run_and_a_checkpoint() {
    let mut run = Run::train(&["--workers=1", "--iterations=2"]);
    run.succeed();
    let dir = run.path();
    let dir = dir.to_str().expect("UTF-8");
    let checkpoint = format!("{dir}/checkpoints/iteration-00000002");
    let evaluate = |target: &str, seed: &str| {
        let output = octopus(&[
            "eval",
            target,
            "--episodes",
            "4",
            "--steps",
            "20",
            "--seed",
            seed,
            "--json",
        ]);
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("JSON")
    };
    let mut first = evaluate(dir, "1");
    let mut second = evaluate(&checkpoint, "1");
    for report in [&mut first, &mut second] {
        // Where it was read from differs, nothing else does.
        report.as_object_mut().expect("an object").retain(|key, _| key != "checkpoint");
    }
    assert_eq!(first, second, "the same goals, the same actions");
    assert_ne!(first, evaluate(dir, "2"), "other goals");
}

/// The means that NumPy computes are those that workers acted on, whatever the networks are made of.
#[test]
fn a_policy_acts_the_same_in_numpy() {
    let f32 = "--set=network.inference=\"f32\"";
    let [tanh, plain] = ["--set=network.activation=\"tanh\"", "--set=network.squash_mean=false"];
    // A deterministic actor's block tells its means only where it does not explore.
    let calm = ["noise", "noise_final", "random", "random_final"]
        .map(|key| format!("--set=algorithm.maddpg.{key}=0.0"));
    let calm: Vec<&str> = calm.iter().map(String::as_str).collect();
    for (more, largest) in [
        (&[f32][..], 1e-5),
        // Products of bfloat16 are not NumPy's.
        (&["--preset=tuned", "--set=network.inference=\"bf16\""], 0.02),
        (&[f32, "--preset=paper"], 1e-5),
        (&[f32, "--preset=paper", tanh, "--algorithm=ppo"], 1e-5),
        (&[f32, "--preset=release", plain], 1e-5),
        (&[&[f32], tests::WITH_POSTURES].concat(), 1e-5),
        (&[&[f32, "--set=task.posture.fade=0.5"], tests::WITH_POSTURES].concat(), 1e-5),
        (&[&[f32, "--algorithm=maddpg"], &calm[..]].concat(), 1e-5),
        (&[&[f32, "--preset=release", "--algorithm=maddpg"], &calm[..]].concat(), 1e-5),
    ] {
        let mut run = Run::train(
            &[
                &["--iterations=3", "--set=network.hidden=[16,16]", "--set=network.head_gain=1.0"]
                    [..],
                // What is replayed makes them large.
                &["--set=run.checkpoints_kept=1"],
                more,
            ]
            .concat(),
        );
        run.succeed();
        let path = run.path();
        let block = path.with_file_name("block.safetensors");
        let [of_run, out] = [&path, &block].map(|path| path.to_str().expect("UTF-8"));
        let latest = format!("{of_run}:latest");
        let rollout = ["rollout", of_run, "--address=7/2/1", "--policy", &latest, "--out", out];
        let output = octopus(&rollout);
        assert!(output.status.success(), "{}", stderr(&output));
        let output = Command::new(python())
            .arg(crosscheck("actor.py"))
            .args([path.join("checkpoints/iteration-00000003"), block])
            .output()
            .expect("Python can be started");
        let said = String::from_utf8_lossy(&output.stdout);
        let error: f64 = said.trim().parse().unwrap_or_else(|_| panic!("{}", stderr(&output)));
        assert!(error < largest, "{more:?}: means differ by {error}");
    }
}

#[test]
fn help_names_every_command() {
    let help = octopus(&["--help"]);
    let text = String::from_utf8_lossy(&help.stdout).into_owned();
    for command in [
        "train",
        "resume",
        "eval",
        "simulate",
        "mjcf",
        "doctor",
        "status",
        "scale",
        "verify",
        "rollout",
        "checkpoints",
        "serve",
        "clean",
    ] {
        assert!(text.contains(command), "{command} is not in\n{text}");
        assert!(octopus(&[command, "--help"]).status.success(), "{command} --help");
    }
}

/// A run that crashed at iteration `at` after it was stopped by nothing else, and so without a last
/// checkpoint: the newest is that of the last multiple of five.
fn crashed(at: &'static str) -> Run {
    let mut run = Run::with_variables(&[("SPACEOCTOPUS_TEST_FAULT", at)]);
    run.start_training(&["--workers=2", "--overlap=0", "--iterations=20"]);
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    run
}

fn calm() -> Vec<String> {
    let mut run = Run::train(&["--workers=1", "--overlap=0", "--iterations=20"]);
    run.succeed();
    run.digests()
}

#[test]
fn what_was_trained_before_the_first_kill_is_compared_after_the_second() {
    let mut run = crashed("crash@14/2");
    let honest = run.digests();
    assert_eq!(honest.len(), 14);
    // As if the first session had computed something else.
    let metrics = run.path().join("metrics.jsonl");
    let other: String = honest[13].chars().rev().collect();
    let text = std::fs::read_to_string(&metrics).expect("readable");
    std::fs::write(&metrics, text.replace(&honest[13], &other)).expect("writable");

    run.set_variables(&[("SPACEOCTOPUS_TEST_FAULT", "crash@12/1")]);
    run.resume(&[]);
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    assert_eq!(run.digests().len(), 12, "it went on from checkpoint 10");
    let promised = run.path().join("promised.jsonl");
    assert!(promised.is_file());

    run.forget_variables();
    run.resume(&[]);
    assert_eq!(run.wait(), Some(1), "{}", run.log());
    let log = run.log();
    assert!(log.contains("iteration 13 was trained on again"), "{log}");
    assert!(log.contains(&other) && log.contains("promised.jsonl"), "{log}");

    // The way out that the message names.
    std::fs::remove_file(&promised).expect("removable");
    run.resume(&[]);
    run.succeed();
    assert_eq!(run.digests(), calm());
    assert!(!promised.exists(), "it is passed");
}

#[test]
fn metrics_that_end_before_the_newest_checkpoint_leave_no_gap() {
    let mut run = crashed("crash@14/2");
    let metrics = run.path().join("metrics.jsonl");
    let keep = |lines: usize| {
        let text = std::fs::read_to_string(&metrics).expect("readable");
        let kept: String = text.split_inclusive('\n').take(lines).collect();
        std::fs::write(&metrics, kept).expect("writable");
    };
    run.forget_variables();
    keep(8);
    run.resume(&[]);
    run.succeed();
    let log = run.log();
    assert!(log.contains("iterations from 8 on are missing"), "{log}");
    assert!(log.contains("going on from checkpoint 5 instead"), "{log}");
    assert_eq!(run.digests(), calm());
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let verified = octopus(&["verify", path, "--replay", "5"]);
    assert!(verified.status.success(), "{}", stderr(&verified));

    // No checkpoint is so old.
    keep(2);
    let refused = octopus(&["resume", path]);
    assert_eq!(refused.status.code(), Some(5), "{}", stderr(&refused));
    for word in ["metrics.jsonl", "from 2 on are missing", "octopus train --config"] {
        assert!(stderr(&refused).contains(word), "{word}: {}", stderr(&refused));
    }
    assert_eq!(run.digests().len(), 2, "nothing is lost");
}

#[test]
fn a_run_says_so_to_who_asks_with_another_token() {
    let dir = tempfile::tempdir().expect("tempdir");
    let file = |name: &str, token: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, token).expect("writable");
        std::fs::set_permissions(&path, Permissions::from_mode(0o600)).expect("ours");
        path.to_str().expect("UTF-8").to_owned()
    };
    let token = file("token.txt", "correct-horse-battery");
    let wrong = file("wrong.txt", "staple-staple-staple");
    let mut run = Run::train(&["--workers=1", "--iterations=100000", "--token-file", &token]);
    run.wait_for_iterations(2);
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let ask = |args: &[&str]| {
        let output = octopus(args);
        let answer = serde_json::from_slice::<serde_json::Value>(&output.stdout);
        (output.status.code(), answer.unwrap_or_default(), stderr(&output))
    };
    {
        let (more, which) = (["--token-file", &wrong], "wrong.txt: the token");
        let args = [&["status", path, "--json"], &more[..]].concat();
        let (code, status, message) = ask(&args);
        assert_eq!((code, &status["state"]), (Some(0), &"running".into()), "{message}");
        assert!(status["live"].is_null(), "{status}");
        assert!(message.contains("are not known") && message.contains("--token-file"), "{message}");
        assert!(message.contains(status["live_error"].as_str().expect("a reason")), "{message}");
        let args = [&["scale", path, "1"], &more[..]].concat();
        let (code, _, message) = ask(&args);
        assert_eq!(code, Some(2), "{message}");
        assert!(message.contains("--token-file") && message.contains(which), "{message}");
    }
    // With the run's own, which is found, or with that of its user.
    for more in [&[][..], &["--token-file", &token]] {
        let (code, status, message) = ask(&[&["status", path, "--json"], more].concat());
        assert_eq!((code, message.as_str()), (Some(0), ""));
        assert_eq!(status["live"]["processes"].as_array().map(Vec::len), Some(3), "{status}");
    }
    let (code, answer, message) = ask(&["scale", path, "2", "--json", "--token-file", &token]);
    assert_eq!((code, &answer["workers"]), (Some(0), &2.into()), "{message}");
    run.signal(Signal::INT);
    run.succeed();
    let (code, status, message) = ask(&["status", path, "--json"]);
    assert_eq!((code, message.as_str()), (Some(0), ""), "nobody is asked any more");
    assert!(status["live_error"].is_null(), "{status}");
}
