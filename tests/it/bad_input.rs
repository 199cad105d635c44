//! Bad input: one clear message, the documented exit code, nothing lost, nothing left behind.

use std::path::Path;

use serde_json::Value;
use tests::{Run, SMALL, octopus, stderr};

/// Runs `octopus` and expects `code` and every one of `words` on standard error.
fn refused(args: &[&str], code: i32, words: &[&str]) {
    let output = octopus(args);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{args:?}:\n{message}");
    for word in words {
        assert!(message.contains(word), "{args:?}: `{word}` is not in\n{message}");
    }
    assert!(!message.contains("panicked"), "{args:?}:\n{message}");
}

/// `octopus train` with the small flags, `more` and a run directory below `dir`.
fn train(dir: &Path, more: &[&str], code: i32, words: &[&str]) {
    let run_dir = format!("--run-dir={}", dir.join("run").display());
    let args: Vec<&str> =
        ["train", "trajectory", &run_dir].iter().chain(SMALL).chain(more).copied().collect();
    refused(&args, code, words);
}

#[test]
fn configurations_that_cannot_be() {
    let dir = tempfile::tempdir().expect("tempdir");
    let at = dir.path();
    train(
        at,
        &["--set=algorithm.gama=0.9"],
        3,
        &["algorithm.gama", "did you mean `algorithm.gamma`"],
    );
    train(at, &["--set=algorithm.gamma=high"], 3, &["algorithm.gamma", "a number such as"]);
    train(at, &["--set=network.hidden=[64,-1]"], 3, &["network.hidden", "none below 0"]);
    train(at, &["--set=network.hidden=[]"], 3, &["network.hidden", "1 to 16 widths"]);
    train(at, &["--set=algorithm.gamma=1.5"], 3, &["algorithm.gamma", "0 to 1"]);
    train(at, &["--set=env.n_shards=32"], 3, &["env.n_shards", "divides"]);
    train(at, &["--set=env.substep=0.03"], 3, &["env.substep", "control period"]);
    train(at, &["--device=tpu"], 3, &["tpu", "cuda:0"]);
    train(at, &["--device=cuda:99"], 4, &["run.device is `cuda:99`", "run.device=cpu"]);
    train(at, &["--robot=no-such-robot.toml"], 3, &["no-such-robot.toml"]);
    for more in ["--listen=off", "--dry-run"] {
        train(at, &[more, "--token-file=no-such-token"], 3, &["no-such-token"]);
    }
    let file = at.join("my.toml");
    std::fs::write(&file, "[network]\nhiden = [64]\n").expect("write");
    let flag = format!("--config={}", file.display());
    train(at, &[&flag], 3, &["my.toml", "network.hiden", "did you mean `network.hidden`"]);
    assert!(!at.join("run").exists(), "a refused run leaves no directory");
}

/// Whatever a value is wrong with, the message says what is wanted, in words.
#[test]
fn values_that_are_none() {
    let run = "/no/such/run";
    let seed = "from 0 to 9,223,372,036,854,775,807";
    for (args, wanted) in [
        (&["train", "--workers", "257"][..], "0 to 256, or `auto`"),
        (&["train", "--workers", "xx"], "0 to 256, or `auto`"),
        (&["resume", run, "--workers", "-1"], "0 to 256, or `auto`"),
        (&["train", "--seed", "-1"], seed),
        (&["train", "--iterations", "-1"], "1 or more"),
        (&["train", "--time-limit", "-3"], "such as 90s"),
        (&["train", "--envs", "many"], "from 1 to 1,000,000"),
        (&["train", "--envs", "18446744073709551615"], "from 1 to 1,000,000"),
        (&["train", "--env-steps", "18446744073709551615"], "at most 9e15"),
        (&["train", "--overlap", "2"], "0 or 1"),
        (
            &["train", "--set", "env.n_envs"],
            "'env.n_envs' for '--set <KEY=VALUE>': wants KEY=VALUE",
        ),
        (&["train", "--listen", "foo"], "localhost:8270, or `off`"),
        (&["serve", "--store", run, "--listen", "localhost"], "127.0.0.1:8270"),
        (&["scale", run, "many"], "or `auto`"),
        (&["scale", run, "-1"], "or `auto`"),
        (&["eval", run, "--episodes", "0"], "from 1 to 1,000,000"),
        (&["eval", run, "--seed", "-1"], "0 or more"),
        (&["verify", run, "--replay", "abc"], "0 or more"),
        (&["checkpoints", "prune", run, "--keep-latest", "0"], "from 1 to"),
        (&["simulate", "--robot=paper", "--actions=-", "--out=-", "--substep", "x"], "seconds"),
    ] {
        refused(args, 2, &["invalid value", "wants", wanted]);
    }
    refused(&["scale", run, "auto"], 5, &["no run is going on"]);
}

#[test]
fn run_directories_that_are_taken() {
    let dir = tempfile::tempdir().expect("tempdir");
    std::fs::create_dir(dir.path().join("run")).expect("mkdir");
    std::fs::write(dir.path().join("run/thesis.tex"), "precious").expect("write");
    train(dir.path(), &["--iterations=1"], 5, &["run", "not empty"]);
    let kept = std::fs::read_to_string(dir.path().join("run/thesis.tex"));
    assert_eq!(kept.expect("still there"), "precious");
    let words = ["/no/such/run: does not exist", "octopus status"];
    for args in [
        &["resume", "/no/such/run"][..],
        &["status", "/no/such/run"],
        &["rollout", "/no/such/run", "--address=1/0/0"],
        &["verify", "/no/such/run", "/no/such/run"],
    ] {
        refused(args, 5, &words);
    }
    refused(&["eval", "/no/such/run"], 5, &["/no/such/run"]);
}

#[test]
fn a_second_run_in_the_same_directory() {
    let mut run = Run::train(&["--iterations=100000"]);
    run.wait_for_iterations(6);
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let advice = format!("stop it first; `octopus status {path}`");
    refused(&["resume", path], 5, &["a run is going on", &advice]);
    // Its room is said by the run, and why it is no larger.
    for workers in ["0", "100"] {
        refused(&["scale", path, workers], 2, &[workers, "1 to 16", "when it started"]);
    }
    run.signal(rustix::process::Signal::INT);
    run.succeed();
}

#[test]
fn a_checkpoint_is_not_resumed_as_if_it_were_a_run() {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/policies/trajectory");
    let copy = tempfile::tempdir().expect("tempdir");
    let files = || {
        let entries = std::fs::read_dir(copy.path()).expect("a directory");
        let mut names: Vec<_> = entries.map(|entry| entry.expect("readable").file_name()).collect();
        names.sort();
        names
    };
    for entry in std::fs::read_dir(shipped).expect("the policies of the repository") {
        let path = entry.expect("readable").path();
        std::fs::copy(&path, copy.path().join(path.file_name().expect("a file"))).expect("copied");
    }
    let before = files();
    let path = copy.path().to_str().expect("UTF-8");
    for command in ["resume", "status"] {
        refused(&[command, path], 5, &[path, "is a checkpoint", "octopus eval"]);
    }
    assert_eq!(files(), before);
}

#[test]
fn a_checkpoint_truncated_or_edited_by_hand() {
    // Without overlap the checkpoint after five iterations is taken before the sixth is trained on.
    let mut run = Run::train(&["--iterations=7", "--overlap=0"]);
    run.succeed();
    let path = run.path();
    let newest = path.join("checkpoints/iteration-00000007");
    let state = newest.join("state.safetensors");
    let bytes = std::fs::read(&state).expect("read");

    std::fs::write(&state, &bytes[..bytes.len() / 2]).expect("truncate");
    let target = newest.to_str().expect("UTF-8");
    refused(&["eval", target, "--episodes=1"], 5, &["state.safetensors", "manifest says"]);
    let held = ["1,000,000 episodes of 200 control steps", "50,000,000"];
    let policies = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/policies/trajectory");
    refused(&["eval", policies, "--episodes=1000000"], 2, &held);
    // The run as a whole falls back to the checkpoint before, loudly.
    let output = octopus(&["eval", path.to_str().expect("UTF-8"), "--episodes=1", "--steps=2"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let warning = stderr(&output);
    assert!(warning.starts_with("error: damaged checkpoint, passed over: "), "{warning}");
    let said = warning.lines().filter(|line| line.contains("state.safetensors")).count();
    assert_eq!(said, 1, "{warning}");

    let mut edited = bytes.clone();
    let last = edited.len() - 1;
    edited[last] ^= 1;
    std::fs::write(&state, &edited).expect("edit");
    refused(&["eval", target, "--episodes=1"], 5, &["state.safetensors", "BLAKE3"]);
    std::fs::write(newest.join("manifest.json"), "{}").expect("edit");
    refused(&["eval", target, "--episodes=1"], 5, &["manifest.json"]);
    std::fs::write(newest.join("manifest.json"), "").expect("edit");
    let cure = [
        "manifest.json: is empty; the checkpoint is damaged: copy it again",
        "octopus checkpoints list",
    ];
    refused(&["eval", target, "--episodes=1"], 5, &cure);
}

#[test]
fn actions_that_are_none() {
    let dir = tempfile::tempdir().expect("tempdir");
    let actions = dir.path().join("actions.csv");
    let out = dir.path().join("out.csv");
    let input = format!("--actions={}", actions.display());
    let output = format!("--out={}", out.display());
    let row = |value: &str| vec![value; 24].join(",");
    for (text, words) in [
        (format!("{}\n{}\n", row("0.1"), vec!["0.1"; 23].join(",")), ["2", "24"]),
        (format!("{}\n", row("nan")), ["row 1", "finite"]),
        (format!("{}\n", row("fast")), ["row 1", "fast"]),
        (String::new(), ["actions.csv", "empty"]),
    ] {
        std::fs::write(&actions, text).expect("write");
        refused(&["simulate", "--robot=paper", &input, &output], 3, &words);
        assert!(!out.exists(), "a refused simulation writes nothing");
    }
    refused(
        &["simulate", "--robot=paper", "--actions=/no/such.csv", &output],
        3,
        &["/no/such.csv"],
    );
}

#[test]
fn robots_that_cannot_be() {
    let dir = tempfile::tempdir().expect("tempdir");
    let good = concat!(env!("CARGO_MANIFEST_DIR"), "/../sim-worker/simulator/robots/two-arm.toml");
    let good = std::fs::read_to_string(good).expect("shipped");
    let path = dir.path().join("robot.toml");
    let flag = format!("--robot={}", path.display());
    let check = |text: &str, words: &[&str]| {
        std::fs::write(&path, text).expect("write");
        refused(&["mjcf", &flag], 3, words);
    };
    assert!(good.contains("mass = "), "the test edits a mass");
    check(&good.replacen("mass = ", "mass = -", 1), &["robot.toml", "mass"]);
    check(&format!("{good}\ncolour = \"red\"\n"), &["robot.toml", "colour"]);
    check("name = 3", &["robot.toml"]);
    check("", &["robot.toml"]);
}

/// Every value of such a file may be allowed; what simulates it looks at what the robot does at home before anything begins.
#[test]
fn robots_that_are_unfit_at_home() {
    let dir = tempfile::tempdir().expect("tempdir");
    let shipped =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../sim-worker/simulator/robots/two-arm.toml");
    let good = std::fs::read_to_string(shipped).expect("shipped");
    let path = dir.path().join("robot.toml");
    let flag = format!("--robot={}", path.display());
    let description = format!("--set=robot.description={}", path.display());
    let actions = dir.path().join("actions.csv");
    std::fs::write(&actions, ["0"; 12].join(",")).expect("write");
    let input = format!("--actions={}", actions.display());
    let every = |from: &str, to: &str, words: &[&str]| {
        assert!(good.contains(from), "the test's text {from:?}");
        std::fs::write(&path, good.replacen(from, to, 1)).expect("write");
        let words = [&["robot.toml: ", "expected"], words].concat();
        train(dir.path(), &[&flag], 3, &words);
        train(dir.path(), &[&flag, "--dry-run"], 3, &words);
        refused(&["bench", "physics", &description], 3, &words);
        refused(&["simulate", &flag, &input, "--out=-"], 3, &words);
        // The way to look at it stays open.
        assert!(octopus(&["mjcf", &flag]).status.success());
    };
    let mount = good.lines().find(|line| line.starts_with("mount_position")).expect("a mount");
    let inside = ["`upper_arm` of arm", "touches the base", "at home", "change mount_position"];
    every(mount, "mount_position = [0.0, 0.0, 0.0]", &inside);
    let mass = good.lines().find(|line| line.starts_with("mass = ")).expect("a mass");
    every(mass, "mass = 1e30", &["base[0] (", ").mass is 1e30 kg", "in kg"]);
    assert!(!dir.path().join("run").exists(), "a refused run leaves no directory");

    let policies = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/policies");
    for (experiment, option) in [("base-mass", "--masses"), ("noise", "--arm-masses")] {
        let args = ["experiment", experiment, "--policies", policies, option, "1,1e30"];
        refused(&args, 3, &[&format!("robot paper with {option} 1e30: "), "expected"]);
    }
}

#[test]
fn what_is_named_in_the_place_of_something_else_is_said_to_be_what_it_is() {
    let policies = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/policies");
    let file = format!("{policies}/trajectory/policy.safetensors");
    let dir = format!("name its directory, {policies}/trajectory");
    refused(&["eval", &file], 5, &["is a file of a checkpoint", &dir]);
    let example = format!("name one of them, such as {policies}/");
    refused(&["eval", policies], 5, &["holds no checkpoint of a run's own", &example]);
    let place = tempfile::tempdir().expect("tempdir");
    let at = |name: &str| place.path().join(name).display().to_string();
    std::fs::write(at("x.urdf"), "<?xml version=\"1.0\"?><robot name=\"x\"/>").expect("written");
    refused(&["robot", "check", &at("x.urdf")], 3, &["is a URDF; `octopus robot import "]);
    std::fs::write(at("empty.toml"), "").expect("written");
    refused(&["robot", "check", &at("empty.toml")], 3, &["empty.toml: is empty"]);
    refused(&["robot", "import", &at("empty.toml")], 3, &["empty.toml: is empty"]);
    refused(&["sweep", &at("empty.toml"), "--dry-run"], 3, &["is empty; a sweep wants"]);
}

#[test]
fn what_a_finished_run_cannot_do_is_said_before_anything_else() {
    let mut run = Run::train(&["--iterations=7", "--overlap=0"]);
    run.succeed();
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    refused(&["rollout", path, "--address=9/5/1"], 2, &["9/5/1", "the run's seed is 7, not 9"]);
    refused(&["rollout", path, "--address=7/5/77"], 2, &["no shard 77", "4 shards"]);
    let words = ["iteration 3", "version 3, was not kept", "only iteration 5 can be made"];
    refused(&["rollout", path, "--address=7/3/1"], 5, &words);
    let output = octopus(&["rollout", path, "--address=7/5/1"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("as the learner recorded it"), "{said}");
    // A block that is not the recorded one is shown, and is no success.
    let metrics = run.path().join("metrics.jsonl");
    let before = std::fs::read_to_string(&metrics).expect("metrics");
    let digest = run.metrics()[5]["blocks"][1].as_str().expect("a digest").to_owned();
    let other = before.replace(&digest, "00000000000000000000000000000000");
    std::fs::write(&metrics, other).expect("writes");
    let output = octopus(&["rollout", path, "--address=7/5/1", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let said: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(
        (&said["same"], said["blake3"].as_str().map(|all| &all[..32])),
        (&false.into(), Some(&*digest))
    );
    std::fs::write(&metrics, before).expect("writes");
    // A smaller budget changes nothing, and is not said to.
    let output = octopus(&["resume", path, "--iterations=3"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let note = "note: nothing to do: 7 iterations are done, 3 wanted; ";
    assert!(stderr(&output).starts_with(note), "{}", stderr(&output));
    // A pause that it is past is not what ended it.
    let output = octopus(&["resume", path, "--pause-at=1"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let note = "note: nothing to do: 7 iterations are done, 7 wanted; a larger --iterations";
    assert!(stderr(&output).starts_with(note), "{}", stderr(&output));
}
