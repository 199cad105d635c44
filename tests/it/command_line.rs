//! What a first user meets on the command line: nothing of theirs is written over, exit codes are those of the table,
//! and what is printed fits on their terminal.

use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::pipe::fcntl_setpipe_size;
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

/// What standard input is read from, a policy that is named beside a run, and one place under two names.
#[test]
fn an_input_is_never_an_output_by_a_way_round_either() {
    let mut run = Run::train(&["--iterations=2"]);
    run.succeed();
    let run_dir = run.path();
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).to_str().expect("UTF-8").to_owned();
    let dir = run_dir.to_str().expect("UTF-8");

    let actions = format!("{}\n", vec!["0.1"; 24].join(","));
    std::fs::write(at("in.csv"), &actions).expect("written");
    let input = std::fs::File::open(at("in.csv")).expect("there");
    let mut simulate = Command::new(program("octopus"));
    simulate.args(["simulate", "--robot=paper", "--actions=-", "--force", "--out", &at("in.csv")]);
    let output = simulate.stdin(input).output().expect("octopus starts");
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("is what --actions reads"), "{}", stderr(&output));
    assert_eq!(std::fs::read_to_string(at("in.csv")).expect("there"), actions);

    let checkpoint = at("iteration-00000002");
    std::fs::create_dir(&checkpoint).expect("made");
    for file in std::fs::read_dir(run_dir.join("checkpoints/iteration-00000002")).expect("there") {
        let file = file.expect("readable").path();
        let name = file.file_name().expect("a name");
        std::fs::copy(&file, Path::new(&checkpoint).join(name)).expect("copied");
    }
    let policy = format!("{checkpoint}/policy.safetensors");
    let before = std::fs::read(&policy).expect("there");
    let block = ["rollout", dir, "--address=7/0/0", "--policy", &checkpoint, "--out", &policy];
    refused(&[&block[..], &["--force"]].concat(), 5, &["which is read"]);
    refused(&block, 5, &["which is a checkpoint"]);
    assert!(std::fs::read(&policy).expect("there") == before, "the policy is as it was");

    let twice = ["plot", dir, "--out", &at("a.svg"), "--save", &at("./a.svg")];
    refused(&twice, 2, &["is what --out writes"]);
    assert!(!Path::new(&at("a.svg")).exists());
    refused(&["plot", dir, "--out", &at("a.png")], 2, &["a.png: wants a name that ends in .svg"]);

    let robot = at("rollout_by_envs.svg");
    let text = include_str!("../../sim-worker/simulator/robots/two-arm.toml");
    std::fs::write(&robot, text).expect("written");
    let description = format!("--set=robot.description={robot}");
    let pictures = format!("--pictures={}", place.path().display());
    let bench = ["bench", "growth", &pictures, &description, "--force"];
    refused(&bench, 2, &["is what --set robot.description reads"]);
    assert_eq!(std::fs::read_to_string(&robot).expect("there"), text);
}

#[test]
fn names_from_files_do_not_command_the_terminal() {
    let mut run = Run::train(&["--iterations=3"]);
    run.succeed();
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).to_str().expect("UTF-8").to_owned();
    let (curves, picture) = (at("curves.json"), at("a.svg"));
    let run_dir = run.path();
    succeeds(&["plot", run_dir.to_str().expect("UTF-8"), "--out", &picture, "--save", &curves]);
    let mut file: Value =
        serde_json::from_slice(&std::fs::read(&curves).expect("there")).expect("JSON");
    file["curves"][0]["run"] = "a\u{1b}[2Jb".into();
    let twice = file["curves"][0].clone();
    file["curves"].as_array_mut().expect("a list").push(twice);
    std::fs::write(&curves, file.to_string()).expect("written");
    for args in [
        &["plot", &curves, "--out", &picture][..],
        &["reproduce", "--runs", &curves, "--policies=/no/such", "--out", &at("out")],
    ] {
        let message = stderr(&octopus(args));
        assert!(message.contains("counts once"), "{args:?}: {message}");
        assert!(message.contains("a\\u{1b}[2Jb") && !message.contains('\u{1b}'), "{message:?}");
    }
    let robot = include_str!("../../sim-worker/simulator/robots/two-arm.toml");
    for (from, to) in [("\"two-arm\"", "\"a\\u001b[2Jb\""), ("\"cube\"", "\"cu\\\"<be\"")] {
        assert!(robot.contains(from), "{from}");
        std::fs::write(at("robot.toml"), robot.replacen(from, to, 1)).expect("written");
        let output = octopus(&["mjcf", "--robot", &at("robot.toml")]);
        assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
        assert!(output.stdout.is_empty() && !stderr(&output).contains('\u{1b}'));
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
    // A file of the run that is empty is damage, whoever reads it.
    let mut run = Run::train(&["--iterations=2"]);
    run.succeed();
    let path = run.path();
    std::fs::write(path.join("config.toml"), "").expect("written");
    let dir = path.to_str().expect("UTF-8");
    for args in [
        &["status", dir][..],
        &["resume", dir],
        &["plot", dir, "--out", "/dev/null"],
        &["rollout", dir, "--address=7/0/0"],
        &["verify", dir, dir],
    ] {
        refused(args, 5, &["config.toml", "missing"]);
    }
    // Each cause is said once.
    let output = octopus(&["train", "--dry-run", "--config=/no/such.toml"]);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(stderr(&output).matches("No such file").count(), 1, "{}", stderr(&output));
}

#[test]
fn what_is_interrupted_ends_with_130() {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/policies");
    let trajectory = format!("{shipped}/trajectory");
    let mut run = Run::train(&["--iterations=2"]);
    run.succeed();
    let dir = run.path();
    let dir = dir.to_str().expect("UTF-8");
    // A reader who takes nothing, so that a block that is made in no time is not written.
    let (_reader, mut full) = std::io::pipe().expect("a pipe");
    fcntl_setpipe_size(&full, 4096).expect("a small one");
    full.write_all(&[b'\n'; 4096]).expect("as much as there is room for");
    for (args, stdout) in [
        (&["eval", &trajectory, "--episodes=100000"][..], None),
        (&["experiment", "precision", "--policies", shipped, "--episodes=100000"], None),
        (&["simulate", "--robot=paper", "--actions=-", "--out=-"], None),
        (&["rollout", dir, "--address=7/2/0"], Some(full)),
    ] {
        let mut command = Command::new(program("octopus"));
        // Actions that never come.
        command.args(args).stdin(Stdio::piped()).stderr(Stdio::null());
        command.stdout(stdout.map_or_else(Stdio::null, Stdio::from));
        let mut process = Owned::spawn(&mut command);
        let watchdog = Instant::now() + Duration::from_mins(2);
        let ended = loop {
            if let Some(ended) = process.ended() {
                break ended;
            }
            assert!(Instant::now() < watchdog, "{args:?} hangs");
            // The signal has to find somebody who listens.
            if threads(process.id()).iter().any(|name| name == "signals") {
                kill(process.id(), Signal::INT);
            }
            std::thread::sleep(Duration::from_millis(50));
        };
        assert_eq!(ended.code(), Some(130), "{args:?}");
    }
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
    let shown = succeeds(&["checkpoints", "show", dir]);
    assert!(shown.starts_with("summary"), "the summary comes first:\n{shown}");
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
    // Not every machine is fit, but every one is told of in lines that fit.
    let doctor = String::from_utf8(octopus(&["doctor"]).stdout).expect("UTF-8");
    // But for the path of the learner, which is as long as it is.
    let learner = program("learner");
    let learner = learner.to_str().expect("UTF-8");
    for line in doctor.lines().filter(|line| !line.contains(learner)) {
        assert!(line.chars().count() <= 80, "{line}\nis too long in\n{doctor}");
    }
    let mut other = Run::train(&["--iterations=6", "--set=run.seed=8"]);
    other.succeed();
    let other_path = other.path();
    let other = other_path.to_str().expect("UTF-8");
    let verified = octopus(&["verify", dir, other]);
    assert_eq!(verified.status.code(), Some(1), "{}", stderr(&verified));
    let verified = String::from_utf8(verified.stdout).expect("UTF-8");
    assert!(verified.contains("part at iteration 0"), "{verified}");
    fits(&verified.replace(other, dir));
}
