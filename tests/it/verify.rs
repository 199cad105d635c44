//! `octopus verify` on real runs: what is the same is found to be, what is not is named.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;
use tests::{Run, kill, octopus, processes_with, program, stderr};

fn finished(more: &[&str]) -> Run {
    let mut run = Run::train(more);
    run.succeed();
    run
}

fn shown(run: &Run) -> String {
    run.path().display().to_string()
}

/// Runs `octopus verify … --json`; expects `code`, returns the result.
fn verify(args: &[&str], code: i32) -> Value {
    let args: Vec<&str> = ["verify"].iter().chain(args).copied().chain(["--json"]).collect();
    let output = octopus(&args);
    assert_eq!(output.status.code(), Some(code), "{args:?}:\n{}", stderr(&output));
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{args:?}: {error}:\n{}", stderr(&output)))
}

/// Starts `octopus verify` with temporary files below `temporary`.
fn start(args: &[&str], temporary: &Path) -> Child {
    Command::new(program("octopus"))
        .arg("verify")
        .args(args)
        .env("TMPDIR", temporary)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("octopus can be started")
}

fn end(process: Child) -> Output {
    process.wait_with_output().expect("own child")
}

/// Every file below a directory, with its content.
fn contents(directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(directory).expect("readable").flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            found.insert(path.clone(), std::fs::read(&path).expect("readable"));
        }
    }
    found
}

fn is_empty(directory: &Path) -> bool {
    std::fs::read_dir(directory).expect("readable").next().is_none()
}

/// Changes the digest of iteration `iteration` as an evil hand would.
fn falsify(run: &Run, iteration: usize) {
    let path = run.path().join("metrics.jsonl");
    let digest = &run.digests()[iteration];
    let other: String = digest.chars().rev().collect();
    assert_ne!(digest, &other);
    let text = std::fs::read_to_string(&path).expect("readable");
    std::fs::write(&path, text.replace(digest, &other)).expect("writable");
}

#[test]
fn two_runs_that_differ_in_harmless_keys_are_the_same() {
    let a = finished(&["--workers=1", "--iterations=8"]);
    let b = finished(&["--workers=2", "--iterations=8", "--set=run.checkpoints_kept=9"]);
    let result = verify(&[&shown(&a), &shown(&b)], 0);
    assert_eq!(result["same"], true);
    assert_eq!((&result["common"], &result["agreeing"]), (&8.into(), &8.into()));
    assert_eq!(result["promised"], true);
    let keys: Vec<_> =
        result["configuration"].as_array().expect("a list").iter().map(|d| &d["key"]).collect();
    assert_eq!(keys, ["run.checkpoints_kept", "run.workers"]);
    assert!(result["configuration"][0]["matters"] == false, "{result}");

    falsify(&b, 5);
    let result = verify(&[&shown(&a), &shown(&b)], 1);
    assert_eq!(result["agreeing"], 5);
    assert_eq!(result["parting"]["iteration"], 5);
    assert_eq!(result["parting"]["env_steps"][0], 6 * 128);
    assert_eq!(result["parting"]["digests"][0], a.digests()[5]);
    let text = octopus(&["verify", &shown(&a), &shown(&b)]);
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(text.contains("the same for 5 iterations, then they part at iteration 5"), "{text}");
    assert!(text.contains("The same bits are promised here"), "{text}");
}

#[test]
fn two_runs_of_other_seeds_part_at_once_and_it_says_why() {
    let a = finished(&["--iterations=4"]);
    let b = finished(&["--iterations=2", "--set=run.seed=8"]);
    let output = octopus(&["verify", &shown(&a), &shown(&b)]);
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(1), ""), "it is an answer");
    let result = verify(&[&shown(&a), &shown(&b)], 1);
    assert_eq!(result["parting"]["iteration"], 0);
    assert_eq!(result["only_in_one"], serde_json::json!([2, 0]));
    assert_eq!(result["promised"], false);
    let seed = result["configuration"].as_array().expect("a list").iter();
    let seed = seed.clone().find(|d| d["key"] == "run.seed").expect("the seed is named");
    assert_eq!(
        (&seed["a"], &seed["b"], &seed["matters"]),
        (&"7".into(), &"8".into(), &true.into())
    );

    let metrics = b.path().join("metrics.jsonl");
    let text = std::fs::read_to_string(&metrics).expect("readable");
    std::fs::write(&metrics, text.replacen('{', "[", 1)).expect("writable");
    let (a, b) = (shown(&a), shown(&b));
    for [first, second] in [[&a[..], &b], [&b, &a], [&a, "/no/such/run"], [&a, "--replay=4"]] {
        let args = ["verify", first, second];
        let output = octopus(&args);
        assert_eq!(output.status.code(), Some(5), "{args:?}: {}", stderr(&output));
    }
}

#[test]
fn without_a_second_run_or_an_iteration_both_forms_are_explained() {
    for args in [&["verify", "runs/x"][..], &["verify", "runs/x", "runs/y", "--replay=3"]] {
        let output = octopus(args);
        assert_eq!(output.status.code(), Some(2));
        let text = stderr(&output);
        assert!(text.contains("RUN RUN_B") && text.contains("RUN --replay K"), "{text}");
    }
}

#[test]
fn a_run_is_not_compared_with_itself() {
    let run = finished(&["--iterations=2"]);
    let path = shown(&run);
    let dir = tempfile::tempdir().expect("tempdir");
    let link = dir.path().join("link");
    std::os::unix::fs::symlink(run.path(), &link).expect("a link");
    for other in [&path, &format!("{path}/."), &link.display().to_string()] {
        let output = octopus(&["verify", &path, other]);
        assert_eq!(output.status.code(), Some(2), "{other}: {}", stderr(&output));
        assert!(stderr(&output).contains("is given twice"), "{}", stderr(&output));
    }
}

#[test]
fn a_replay_repeats_the_recorded_bits_and_leaves_the_run_as_it_was() {
    let run = finished(&["--workers=2", "--overlap=1", "--iterations=23"]);
    let path = shown(&run);
    // Of 20 iterations and of 23 a checkpoint is there, of fewer none, whatever retention kept.
    for iteration in 1..20 {
        let dir = run.path().join(format!("checkpoints/iteration-{iteration:08}"));
        let _ = std::fs::remove_dir_all(dir);
    }
    let before = contents(&run.path());
    let temporary = tempfile::tempdir().expect("tempdir");
    for (through, from) in [(21, 20), (6, 0)] {
        let iteration = through.to_string();
        let output = end(start(&[&path, "--replay", &iteration, "--json"], temporary.path()));
        assert!(output.status.success(), "{}", stderr(&output));
        let result: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!((&result["from"], &result["through"]), (&from.into(), &through.into()));
        assert_eq!(result["agreeing"], through + 1 - from, "{result}");
        assert_eq!(result["checkpoint"].is_null(), from == 0, "{result}");
        assert!(is_empty(temporary.path()), "temporary files are left");
    }
    assert!(before == contents(&run.path()), "the replay changed the run");

    falsify(&run, 21);
    let output = end(start(&[&path, "--replay=22"], temporary.path()));
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("the same for 1 iteration, then they part at iteration 21"), "{text}");
    assert!(is_empty(temporary.path()), "temporary files are left");
}

#[test]
fn a_replay_that_is_stopped_leaves_nothing() {
    let run = finished(&["--workers=2", "--overlap=1", "--iterations=150"]);
    std::fs::remove_dir_all(run.path().join("checkpoints")).expect("removable");
    let temporary = tempfile::tempdir().expect("tempdir");
    let process = start(&[&shown(&run), "--replay=149"], temporary.path());
    let pid = process.id();
    // Until the first iterations are trained on again.
    let watchdog = Instant::now() + Duration::from_mins(2);
    let begun = || {
        let mut runs = std::fs::read_dir(temporary.path()).expect("readable").flatten();
        runs.any(|run| {
            let metrics = std::fs::metadata(run.path().join("metrics.jsonl"));
            metrics.is_ok_and(|metrics| metrics.len() > 0)
        })
    };
    while !begun() {
        if Instant::now() > watchdog {
            kill(pid, Signal::KILL);
            panic!("the replay does not begin: {}", stderr(&end(process)));
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    kill(pid, Signal::INT);
    let output = end(process);
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    assert!(stderr(&output).contains("stopped by Ctrl-C"), "{}", stderr(&output));
    assert!(is_empty(temporary.path()), "temporary files are left");
    let here = temporary.path().to_str().expect("UTF-8");
    assert_eq!(processes_with(here), [], "processes are left");
}

fn promised_are(text: &str) -> bool {
    text.contains("The same bits are promised here")
}

fn checkpoint(run: &Run, iteration: u64) -> PathBuf {
    run.path().join(format!("checkpoints/iteration-{iteration:08}"))
}

/// The learning rate falls over the budget: until a resume changes it, over the one before.
#[test]
fn a_budget_that_was_changed_is_no_defect() {
    let kept = "--set=run.checkpoints_kept=9";
    let mut changed = finished(&["--workers=2", "--overlap=0", "--iterations=8", kept]);
    changed.resume(&["--iterations=10"]);
    changed.succeed();
    let path = shown(&changed);
    for (through, from) in [(3, 0), (6, 5), (9, 8)] {
        let result = verify(&[&path, "--replay", &through.to_string()], 0);
        assert_eq!(
            (&result["from"], &result["promised"]),
            (&from.into(), &true.into()),
            "{result}"
        );
        assert_eq!(result["agreeing"], through + 1 - from, "{result}");
    }
    // With the same budget in the end, but not on the way.
    let straight = finished(&["--workers=2", "--overlap=0", "--iterations=10"]);
    assert_ne!(straight.digests()[..8], changed.digests()[..8], "another course");
    let output = octopus(&["verify", &path, &shown(&straight)]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(!promised_are(&text) && text.contains("1024, 1280 from iteration"), "{text}");

    // Nothing is left of where the other budget began.
    std::fs::remove_dir_all(checkpoint(&changed, 8)).expect("removable");
    let output = octopus(&["verify", &path, "--replay=9"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("the same for 3 iterations; none differs"), "{text}");
    assert!(stderr(&output).contains("another from iteration 8 on"), "{}", stderr(&output));
}

#[test]
fn a_replay_begins_from_no_foreign_and_no_damaged_checkpoint() {
    let flags = ["--workers=2", "--overlap=0", "--iterations=12"];
    let run = finished(&flags);
    let other = finished(&[&flags[..2], &["--iterations=7", "--set=run.seed=8"]].concat());
    let copied =
        Command::new("cp").arg("-r").args([checkpoint(&other, 7), checkpoint(&run, 7)]).status();
    assert!(copied.expect("cp starts").success());
    let path = shown(&run);
    let again = || {
        let output = octopus(&["verify", &path, "--replay=8"]);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text}\n{}", stderr(&output));
        stderr(&output)
    };
    let said = again();
    assert!(said.contains("iteration-00000007: has digest"), "{said}");
    assert!(said.contains("training again from checkpoint 5 instead"), "{said}");
    // What is newer than the iteration was never asked for.
    for iteration in [5, 10] {
        std::fs::write(checkpoint(&run, iteration).join("state.safetensors"), "short")
            .expect("own");
    }
    let said = again();
    assert_eq!(said.matches("iteration-00000005/state.safetensors").count(), 1, "{said}");
    assert!(said.contains("training again from nothing instead"), "{said}");
    assert!(!said.contains("iteration-00000010") && !said.contains("before"), "{said}");
}

#[test]
fn a_replay_whose_learner_is_killed_goes_on() {
    let run =
        finished(&["--workers=2", "--overlap=1", "--iterations=150", "--set=run.keep_every=5"]);
    for iteration in (25..=150).step_by(5) {
        let _ = std::fs::remove_dir_all(checkpoint(&run, iteration));
    }
    let temporary = tempfile::tempdir().expect("tempdir");
    let process = start(&[&shown(&run), "--replay=149", "--json"], temporary.path());
    let here = temporary.path().to_str().expect("UTF-8").to_owned();
    let begun = || {
        let mut runs = std::fs::read_dir(temporary.path()).expect("readable").flatten();
        runs.any(|run| {
            let metrics = std::fs::metadata(run.path().join("metrics.jsonl"));
            metrics.is_ok_and(|metrics| metrics.len() > 0)
        })
    };
    let watchdog = Instant::now() + Duration::from_mins(2);
    while !begun() && Instant::now() < watchdog {
        std::thread::sleep(Duration::from_millis(2));
    }
    let learners = processes_with(&here);
    let learners: Vec<u32> =
        learners.into_iter().filter(|(_, name)| name == "learner").map(|(pid, _)| pid).collect();
    for &learner in &learners {
        kill(learner, Signal::KILL);
    }
    let output = end(process);
    assert_eq!(learners.len(), 1, "{}", stderr(&output));
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("going on from iteration 20"), "{}", stderr(&output));
    let result: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((&result["from"], &result["agreeing"]), (&20.into(), &130.into()), "{result}");
    assert!(is_empty(temporary.path()), "temporary files are left");
    assert_eq!(processes_with(&here), [], "processes are left");
}
