//! What a first user meets on the command line: nothing of theirs is written over, exit codes are those of the table,
//! and what is printed fits on their terminal.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;
use tests::{Owned, Run, kill, octopus, program, stderr};

fn refused(args: &[&str], code: i32, words: &[&str]) {
    let output = octopus(args);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{args:?}:\n{message}");
    for word in words {
        assert!(message.contains(word), "{args:?}: `{word}` is not in\n{message}");
    }
}

fn succeeds(args: &[&str]) -> String {
    let output = octopus(args);
    assert!(output.status.success(), "{args:?}:\n{}", stderr(&output));
    String::from_utf8(output.stdout).expect("UTF-8")
}

#[test]
fn an_input_is_never_an_output() {
    let dir = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    let actions = format!("{}\n", vec!["0.1"; 24].join(","));
    std::fs::write(at("in.csv"), &actions).expect("written");
    std::fs::hard_link(at("in.csv"), at("same.csv")).expect("linked");
    let simulate = |out: &str, more: &[&str]| {
        let (input, out) = (format!("--actions={}", at("in.csv")), format!("--out={}", at(out)));
        let args = ["simulate", "--robot=paper", &input, &out];
        [&args[..], more].concat().into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    let run = |args: &[String]| octopus(&args.iter().map(String::as_str).collect::<Vec<_>>());
    for out in ["in.csv", "same.csv"] {
        for more in [&[][..], &["--force"]] {
            let output = run(&simulate(out, more));
            assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
            assert!(stderr(&output).contains("is what --actions reads"), "{}", stderr(&output));
            assert_eq!(std::fs::read_to_string(at("in.csv")).expect("there"), actions);
        }
    }
    std::fs::write(at("thesis.tex"), "precious").expect("written");
    let output = run(&simulate("thesis.tex", &[]));
    assert_eq!(output.status.code(), Some(5), "{}", stderr(&output));
    assert_eq!(std::fs::read_to_string(at("thesis.tex")).expect("there"), "precious");
    // What the command made itself is made anew, and anything if a person insists.
    for (out, more) in [("new.csv", &[][..]), ("new.csv", &[]), ("thesis.tex", &["--force"])] {
        let output = run(&simulate(out, more));
        assert!(output.status.success(), "{}", stderr(&output));
    }
}

#[test]
fn a_runs_directory_stays_the_runs() {
    let mut run = Run::train(&["--iterations=4"]);
    run.succeed();
    let dir = run.path();
    let files = || {
        let mut files: Vec<_> =
            std::fs::read_dir(&dir).expect("there").flatten().map(|entry| entry.path()).collect();
        files.sort();
        files
    };
    let before = files();
    let dir = dir.to_str().expect("UTF-8");
    let inside = |name: &str| format!("{dir}/{name}");
    refused(&["reproduce", "--quick", "--out", dir], 5, &["is a run directory"]);
    refused(&["reproduce", "--quick", "--force", "--out", dir], 5, &["is a run directory"]);
    refused(
        &["mjcf", "--robot=paper", "--out", &inside("x.xml")],
        5,
        &["which is a run directory"],
    );
    refused(&["plot", dir, "--out", &inside("curve.svg")], 5, &["which is a run directory"]);
    let metrics = inside("metrics.jsonl");
    refused(&["plot", dir, "--out", &metrics, "--force"], 5, &["which is read"]);
    refused(&["train", "--run-dir", &inside("another")], 5, &["which is a run directory"]);
    let block = ["rollout", dir, "--address=7/0/0", "--out", &inside("config.toml"), "--force"];
    refused(&block, 5, &["which is read"]);
    let archive = inside("checkpoints/best.tar");
    refused(&["checkpoints", "export", dir, "--out", &archive], 5, &["which is a run directory"]);
    assert_eq!(files(), before);

    // A directory of other things is no store either.
    let other = tempfile::tempdir().expect("tempdir");
    std::fs::write(other.path().join("thesis.tex"), "precious").expect("written");
    let archive = other.path().join("last.tar");
    succeeds(&["checkpoints", "export", dir, "--out", archive.to_str().expect("UTF-8")]);
    let (archive, store) =
        (archive.to_str().expect("UTF-8"), other.path().to_str().expect("UTF-8"));
    let import = ["checkpoints", "import", archive, "--store", store, "--name", "a"];
    refused(&import, 5, &["\"last.tar\" and no checkpoint", "--force"]);
    succeeds(&[&import[..], &["--force"]].concat());

    // One run that is named twice is one seed.
    let picture = other.path().join("curves.svg");
    let picture = picture.to_str().expect("UTF-8");
    let output = octopus(&["plot", dir, &format!("{dir}/."), "--json", "--out", picture]);
    assert!(stderr(&output).contains("counts once"), "{}", stderr(&output));
    let curves: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(curves[0]["runs"].as_array().map(Vec::len), Some(1), "{}", curves[0]["runs"]);
    assert_eq!(curves[0]["name"], "mappo");
}

#[test]
fn exit_codes_are_those_of_the_table() {
    let twice = ["checkpoints", "compose", "--arm", "1,1=runs/a", "--out", "shared/x"];
    refused(&twice, 2, &["arm 1 is given twice"]);
    let twice = ["checkpoints", "compose", "--arm", "1=a", "--arm", "1=b", "--out", "shared/x"];
    refused(&twice, 2, &["arm 1 is given twice"]);
    // Each cause is said once.
    let output = octopus(&["train", "--dry-run", "--config=/no/such.toml"]);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(stderr(&output).matches("No such file").count(), 1, "{}", stderr(&output));
}

#[test]
fn a_measurement_that_is_interrupted_ends_with_130() {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/policies/trajectory");
    let mut eval = Command::new(program("octopus"));
    eval.args(["eval", shipped, "--episodes=100000"]).stdin(Stdio::null());
    let mut process = Owned::spawn(eval.stdout(Stdio::null()).stderr(Stdio::null()));
    let watchdog = Instant::now() + Duration::from_mins(2);
    let ended = loop {
        if let Some(ended) = process.ended() {
            break ended;
        }
        assert!(Instant::now() < watchdog, "it hangs");
        // The signal has to find somebody who listens.
        if threads(process.id()).iter().any(|name| name == "signals") {
            kill(process.id(), Signal::INT);
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    assert_eq!(ended.code(), Some(130));
}

/// Names of a process's threads.
fn threads(pid: u32) -> Vec<String> {
    let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    tasks
        .filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok())
        .map(|name| name.trim().to_owned())
        .collect()
}

#[test]
fn what_is_printed_fits_in_80_columns() {
    let mut run = Run::train(&["--iterations=6", "--set=run.checkpoint_every=2"]);
    run.succeed();
    let path = run.path();
    let dir = path.to_str().expect("UTF-8");
    let second = format!("{dir}:2");
    let fits = |text: &str| {
        assert!(text.lines().count() > 2, "{text}");
        // A path is as long as it is.
        for line in text.lines().filter(|line| !line.contains(dir)) {
            assert!(line.chars().count() <= 80, "{line}\nis too long in\n{text}");
        }
    };
    let evaluation = succeeds(&["eval", dir, "--episodes=2", "--steps=20"]);
    fits(&evaluation);
    let verdict = evaluation.lines().nth(3).expect("a verdict");
    assert!(verdict.contains("the paper's accuracy"), "the verdict comes first:\n{evaluation}");
    assert!(!evaluation.contains("agent 7"), "{evaluation}");
    let agents = succeeds(&["eval", dir, "--episodes=2", "--steps=20", "--agents"]);
    assert!(agents.contains("agent 7 orientation"), "{agents}");
    fits(&agents);
    for args in [
        &["checkpoints", "list", dir][..],
        &["checkpoints", "show", dir],
        &["checkpoints", "show", dir, "--tensors"],
        &["status", dir],
    ] {
        fits(&succeeds(args));
    }
    let difference = octopus(&["checkpoints", "diff", &second, dir]);
    assert_eq!(difference.status.code(), Some(1));
    let difference = String::from_utf8(difference.stdout).expect("UTF-8");
    assert!(difference.starts_with("different\ntensors "), "{difference}");
    fits(&difference);
    let out = path.with_file_name("curve.svg");
    fits(&succeeds(&["plot", dir, "--out", out.to_str().expect("UTF-8")]));
    assert!(Path::new(&out).is_file());
}
