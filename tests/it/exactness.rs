//! The same bits whatever happens.

use std::time::{Duration, Instant};

use rustix::process::Signal;
use tests::{Run, assert_nothing_left, kill, octopus, stderr};

/// Digests of a calm run with `workers` workers.
fn calm(workers: &str, overlap: &str, iterations: &str) -> Vec<String> {
    let mut run = Run::train(&[
        &format!("--workers={workers}"),
        &format!("--overlap={overlap}"),
        &format!("--iterations={iterations}"),
    ]);
    run.succeed();
    for line in run.metrics() {
        assert_eq!(line["accounting"]["lost"], 0, "nobody died: {line}");
    }
    run.digests()
}

#[test]
fn the_number_of_workers_changes_no_bit() {
    for overlap in ["0", "1"] {
        let one = calm("1", overlap, "6");
        assert_eq!(one.len(), 6);
        assert_ne!(one[0], one[1], "training moves the parameters");
        for workers in ["2", "3", "5"] {
            assert_eq!(calm(workers, overlap, "6"), one, "{workers} workers, overlap {overlap}");
        }
    }
}

#[test]
fn a_killed_worker_is_replaced_and_changes_no_bit() {
    let expected = calm("2", "1", "40");
    let mut run = Run::train(&["--workers=2", "--overlap=1", "--iterations=40"]);
    for at in [3, 9, 15] {
        run.wait_for_iterations(at);
        let workers = run.children("sim-worker");
        assert!(!workers.is_empty(), "no worker lives");
        kill(workers[0], Signal::KILL);
    }
    let domain = run.domain();
    run.succeed();
    assert_eq!(run.digests(), expected);
    assert!(run.log().contains("has been replaced"), "{}", run.log());
    for line in run.metrics() {
        let steps = |key: &str| line["accounting"][key].as_u64().expect("a count");
        assert_eq!(
            steps("produced"),
            steps("trained") + steps("duplicate") + steps("lost"),
            "{line}"
        );
        assert_eq!(steps("trained"), 128);
    }
    assert_nothing_left(&domain);
}

#[test]
fn a_stop_and_a_resume_change_no_bit() {
    for overlap in ["0", "1"] {
        let overlap_flag = format!("--overlap={overlap}");
        let expected = calm("2", overlap, "40");
        let mut run = Run::train(&["--workers=2", &overlap_flag, "--iterations=40"]);
        run.wait_for_iterations(4);
        let domain = run.domain();
        run.signal(Signal::INT);
        run.succeed();
        assert_nothing_left(&domain);
        let done = run.digests().len();
        assert!((4..40).contains(&done), "stopped after {done} iterations");
        run.resume(&["--workers=1"]);
        run.succeed();
        assert_eq!(run.digests(), expected, "overlap {overlap}, stopped after {done}");
    }
}

/// Unlike another budget, over which the learning rate would fall faster.
#[test]
fn a_pause_changes_no_bit() {
    for overlap in ["0", "1"] {
        let overlap_flag = format!("--overlap={overlap}");
        let expected = calm("2", overlap, "12");
        let budget = ["--workers=2", &overlap_flag, "--iterations=12", "--pause-at=5"];
        let mut run = Run::train(&budget);
        run.succeed();
        assert_eq!(run.digests(), expected[..5], "overlap {overlap}");
        assert!(run.path().join("checkpoints/iteration-00000005").is_dir());
        // It is there already; then further on, and to the end, which is before the last pause.
        let path = run.path();
        let again = ["resume", path.to_str().expect("UTF-8"), "--pause-at=5", "--json"];
        let output = octopus(&again);
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(stderr(&output).contains("a larger --pause-at, or none, goes on"));
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!((&json["stopped_by"], &json["iterations"]), (&"pause".into(), &5.into()));
        run.resume(&["--pause-at=7"]);
        run.succeed();
        assert_eq!(run.digests(), expected[..7], "overlap {overlap}");
        run.resume(&["--pause-at=100"]);
        run.succeed();
        assert_eq!(run.digests(), expected, "overlap {overlap}");
    }
}

#[test]
fn a_killed_coordinator_leaves_nothing_and_its_run_resumes_to_the_same_bits() {
    let expected = calm("2", "1", "40");
    let mut run = Run::train(&["--workers=2", "--overlap=1", "--iterations=40"]);
    run.wait_for_iterations(12);
    let domain = run.domain();
    run.signal(Signal::KILL);
    assert_eq!(run.wait(), None);
    assert_nothing_left(&domain);
    run.resume(&[]);
    run.succeed();
    assert_eq!(run.digests(), expected);
}

#[test]
fn a_killed_learner_is_started_again_from_the_last_checkpoint() {
    for overlap in ["0", "1"] {
        let overlap_flag = format!("--overlap={overlap}");
        let expected = calm("2", overlap, "40");
        let mut run = Run::train(&["--workers=2", &overlap_flag, "--iterations=40"]);
        let domain = run.domain_when_there();
        for at in [3, 12, 23] {
            run.wait_for_iterations(at);
            for learner in run.children("learner") {
                kill(learner, Signal::KILL);
            }
        }
        run.succeed();
        assert!(run.log().contains("the learner died (signal 9)"), "{}", run.log());
        assert_eq!(run.digests(), expected, "overlap {overlap}");
        assert_nothing_left(&domain);
    }
}

#[test]
fn processes_that_hang_are_replaced_and_change_no_bit() {
    let expected = calm("2", "0", "40");
    let deadline = "--set=run.order_deadline_s=3.0";
    let mut run = Run::train(&["--workers=2", "--overlap=0", "--iterations=40", deadline]);
    let domain = run.domain_when_there();
    for (at, program) in [(3, "sim-worker"), (14, "learner")] {
        run.wait_for_iterations(at);
        kill(run.children(program)[0], Signal::STOP);
    }
    run.succeed();
    assert!(run.log().contains("has been silent for 3 s"), "{}", run.log());
    assert!(run.log().contains("the learner died (hung)"), "{}", run.log());
    assert_eq!(run.digests(), expected);
    assert_nothing_left(&domain);
}

/// It made other blocks than the one before it, and the run ended well with other bits.
#[test]
fn a_process_that_finds_its_files_changed_ends_the_run() {
    let expected = calm("1", "0", "60");
    // Of a learner and a worker that both start, whoever refuses first decides how the run ends.
    let cases: [(_, _, &[i32]); 2] =
        [("config.toml", "sim-worker", &[5]), ("robot.toml", "learner", &[3, 5])];
    for (file, program, codes) in cases {
        let mut run = Run::train(&["--workers=1", "--overlap=0", "--iterations=60"]);
        let domain = run.domain_when_there();
        run.wait_for_iterations(3);
        let path = run.path().join(file);
        let before = std::fs::read_to_string(&path).expect("readable");
        // Of the configuration a value, of the robot a word.
        let changed = match file {
            "config.toml" => before.replace("order_deadline_s = 60.0", "order_deadline_s = 61.0"),
            _ => format!("{before}# a word of mine\n"),
        };
        assert_ne!(changed, before);
        std::fs::write(&path, changed).expect("writable");
        // Who asks for another worker is told, and the run goes on.
        let directory = run.path();
        let refused = octopus(&["scale", directory.to_str().expect("UTF-8"), "2"]);
        assert!(!refused.status.success());
        assert!(
            stderr(&refused).contains(&format!("{file}: it was changed")),
            "{}",
            stderr(&refused)
        );
        assert!(!run.log().contains("was changed"), "{}", run.log());
        kill(run.children(program)[0], Signal::KILL);
        let code = run.wait();
        assert!(code.is_some_and(|code| codes.contains(&code)), "{code:?}: {}", run.log());
        let said = format!("{file}: ");
        assert!(run.log().contains(&said), "{}", run.log());
        assert!(run.log().contains("changed since the session of the run began"), "{}", run.log());
        assert_nothing_left(&domain);
        std::fs::write(&path, before).expect("writable");
        run.resume(&["--workers=1"]);
        run.succeed();
        assert_eq!(run.digests(), expected, "{file}");
    }
}

/// It ended the run when the next process started.
#[test]
fn a_comment_in_the_configuration_of_a_live_run_changes_nothing() {
    let expected = calm("1", "0", "60");
    let mut run = Run::train(&["--workers=1", "--overlap=0", "--iterations=60"]);
    run.wait_for_iterations(3);
    let path = run.path().join("config.toml");
    let before = std::fs::read_to_string(&path).expect("readable");
    std::fs::write(&path, format!("# a word of mine\n{before}")).expect("writable");
    for program in ["sim-worker", "learner"] {
        kill(run.children(program)[0], Signal::KILL);
    }
    run.succeed();
    assert!(run.log().contains("the learner died (signal 9)"), "{}", run.log());
    assert_eq!(run.digests(), expected);
}

#[test]
fn scaling_a_live_run_changes_no_bit() {
    let expected = calm("2", "1", "60");
    let mut run = Run::train(&["--workers=1", "--overlap=1", "--iterations=60"]);
    let domain = run.domain_when_there();
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    for (at, workers) in [(4, 5), (14, 2), (24, 3)] {
        run.wait_for_iterations(at);
        let output = octopus(&["scale", path, &workers.to_string(), "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let answer: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(answer["workers"], workers);
    }
    let refused = octopus(&["scale", path, "1000"]);
    assert!(!refused.status.success());
    assert!(stderr(&refused).contains("1000 workers"), "{}", stderr(&refused));
    run.succeed();
    assert_eq!(run.digests(), expected);
    let workers: Vec<_> =
        run.metrics().iter().map(|line| line["workers"].as_u64().expect("a count")).collect();
    for wanted in [1, 5, 2, 3] {
        assert!(workers.contains(&wanted), "{workers:?}");
    }
    assert_nothing_left(&domain);
}

#[test]
fn scaling_up_and_down_and_up_again_at_once_waits_for_room() {
    let expected = calm("2", "1", "60");
    let mut run = Run::train(&["--workers=1", "--overlap=1", "--iterations=60"]);
    let domain = run.domain_when_there();
    run.wait_for_iterations(4);
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    // As many as the channels have room for: those that come up are told to go before they are
    // ready, and those on their way out still hold their ports when the next ones are wanted.
    let status = octopus(&["status", path, "--json"]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).expect("JSON");
    let most = status["live"]["max_workers"].as_u64().expect("a count").to_string();
    for workers in [&most, "1", &most, "2", &most, "2"] {
        let output = octopus(&["scale", path, workers]);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    run.succeed();
    assert_eq!(run.digests(), expected);
    assert_eq!(run.metrics().last().expect("lines")["workers"], 2);
    assert!(!run.log().contains("died"), "{}", run.log());
    assert_nothing_left(&domain);
}

#[test]
fn processes_that_hang_before_they_are_ready_are_replaced() {
    let expected = calm("2", "0", "40");
    let deadline = "--set=run.order_deadline_s=3.0";
    let mut run = Run::train(&["--workers=1", "--overlap=0", "--iterations=40", deadline]);
    let domain = run.domain_when_there();
    // As soon as they exist: they have loaded nothing yet.
    for program in ["sim-worker", "learner"] {
        let watchdog = Instant::now() + Duration::from_mins(1);
        let hung = loop {
            if let Some(&process) = run.children(program).first() {
                break process;
            }
            let ended = run.ended();
            let waits = ended.is_none() && Instant::now() < watchdog;
            assert!(waits, "no {program} starts: {ended:?}; log:\n{}", run.log());
        };
        kill(hung, Signal::STOP);
    }
    run.succeed();
    assert!(run.log().contains("the learner died (hung)"), "{}", run.log());
    assert_eq!(run.digests(), expected);
    assert_nothing_left(&domain);
}

#[test]
fn foreign_settings_of_numerical_libraries_change_no_bit() {
    let expected = calm("2", "0", "6");
    let mut run = Run::with_variables(&[
        ("OMP_NUM_THREADS", "3"),
        ("MKL_NUM_THREADS", "2"),
        ("OMP_SCHEDULE", "dynamic,1"),
        ("ATEN_CPU_CAPABILITY", "default"),
        ("MKL_CBWR", "COMPATIBLE"),
        ("ONEDNN_MAX_CPU_ISA", "AVX2"),
    ]);
    run.start_training(&["--workers=2", "--overlap=0", "--iterations=6"]);
    run.succeed();
    assert_eq!(run.digests(), expected);
}

#[test]
fn an_evaluation_on_the_workers_changes_no_bit_and_finds_a_best_checkpoint() {
    let expected = calm("2", "1", "30");
    let flags = [
        "--workers=2",
        "--overlap=1",
        "--iterations=30",
        "--set=run.evaluate_every=4",
        "--set=run.checkpoint_every=10",
        "--set=run.evaluation_episodes=18",
        "--set=run.evaluation_steps=10",
        "--set=run.best_after=600",
    ];
    let mut scores = Vec::new();
    for _ in 0..2 {
        let mut run = Run::train(&flags);
        run.succeed();
        assert_eq!(run.digests(), expected);
        let show = |name: &str| {
            let selector = format!("{}:{name}", run.path().display());
            let output = octopus(&["checkpoints", "show", &selector, "--json"]);
            assert!(output.status.success(), "{}", stderr(&output));
            serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("JSON")
        };
        let best = show("best");
        // 600 env-steps are reached by the fifth iteration of 128.
        assert!(best["iteration"].as_u64().is_some_and(|iteration| iteration >= 5), "{best}");
        let score = |checkpoint: &serde_json::Value| checkpoint["labels"]["score"].clone();
        // The last policy is evaluated whatever its iteration.
        let last = score(&show("iteration-00000030"));
        let value = |score: &serde_json::Value| score["value"].as_f64().expect("a score");
        assert!(value(&score(&best)) <= value(&last), "{best}");
        scores.push(last);
    }
    assert_eq!(scores[0], scores[1], "a score is a pure function of the policy");
}

#[test]
fn a_second_signal_stops_at_once() {
    let mut run = Run::train(&["--workers=2", "--iterations=100000"]);
    run.wait_for_iterations(6);
    let domain = run.domain();
    run.signal(Signal::TERM);
    run.signal(Signal::INT);
    let code = run.wait();
    // The first one may have been through before the second came.
    assert!(matches!(code, Some(0 | 130)), "{code:?}: {}", run.log());
    assert_nothing_left(&domain);
}
