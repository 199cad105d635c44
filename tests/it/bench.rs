//! `octopus bench`: every figure is there, nothing is left behind. How fast is no test's business.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;
use tests::{Owned, assert_nothing_left, kill, octopus, program, stderr};

/// A configuration that is measured in a moment.
const SMALL: &[&str] = &[
    "--set=env.n_envs=16",
    "--set=env.n_shards=4",
    "--set=task.episode_steps=8",
    "--set=network.hidden=[16]",
    "--set=run.learner_threads=1",
];

/// The command, with temporary files in `dir`.
fn bench(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(program("octopus"));
    command.arg("bench").args(SMALL).args(args).env("TMPDIR", dir).stdin(Stdio::null());
    command
}

/// The output of a measurement that does not contradict itself: short ones beside other tests may, and are then refused.
fn consistent(command: impl Fn() -> Command) -> Output {
    const TURNS: usize = 5;
    for _ in 0..TURNS {
        let output = command().output().expect("octopus starts");
        if output.status.success() {
            return output;
        }
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains("contradict each other"), "{}", stderr(&output));
        assert!(output.stdout.is_empty(), "no table");
    }
    panic!("{TURNS} measurements contradicted themselves");
}

fn is_empty(dir: &Path) -> bool {
    std::fs::read_dir(dir).expect("a directory").next().is_none()
}

/// Names of shared-memory domains in a text.
fn domains(text: &str) -> Vec<String> {
    let word = |c: char| !c.is_ascii_alphanumeric() && c != '-';
    let name = |word: &&str| word.starts_with("octopus-") && word.split('-').count() == 3;
    let words = text.split(word).filter(name);
    words.filter(|word| !word.contains("bench")).map(str::to_owned).collect()
}

#[test]
fn batches_in_python_are_measured_beside_the_native_rollout_and_mujoco() {
    let dir = tempfile::tempdir().expect("a directory");
    let python = format!("--python={}", tests::wheel::python().display());
    let output = consistent(|| bench(dir.path(), &["python", "--seconds=0.05", "--json", &python]));
    let figures: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let number = |key: &str| figures[key].as_f64().filter(|x| *x > 0.0 && x.is_finite());
    for n in [1, 16, 1024] {
        let rate = number(&format!("python.batch_{n}.env_steps_per_s_per_core"));
        let peer = number(&format!("python.batch_{n}.peer_env_steps_per_s_per_core"));
        assert!(rate.is_some() && peer.is_some(), "{n}: {figures}");
    }
    let native = number("python.native.env_steps_per_s_per_core").expect("a rate");
    let batch = number("python.batch_1024.env_steps_per_s_per_core").expect("a rate");
    assert_eq!(number("python.share_of_native"), Some(batch / native));
    assert!(is_empty(dir.path()), "nothing is left");

    // A Python without the wheel, and one that is none.
    let output = bench(dir.path(), &["python", "--python=/nowhere/python"]).output().expect("run");
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let script = dir.path().join("python");
    std::fs::write(&script, "#!/bin/sh\necho 'no module spaceoctopus' >&2; exit 3\n")
        .expect("written");
    std::fs::set_permissions(&script, Permissions::from_mode(0o755)).expect("executable");
    let python = format!("--python={}", script.display());
    let output = bench(dir.path(), &["python", "--seconds=0.05", &python]).output().expect("run");
    assert!(stderr(&output).contains("no module spaceoctopus"), "{}", stderr(&output));
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
}

#[test]
fn every_figure_is_measured_and_nothing_is_left() {
    let dir = tempfile::tempdir().expect("a directory");
    let output = consistent(|| {
        let mut command = bench(dir.path(), &["--seconds=0.05", "--workers=1", "--json"]);
        command.env("RUST_LOG", "info");
        command
    });
    let figures: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    for key in [
        "physics.env_steps_per_s_per_core",
        "physics.floor_env_steps_per_s_per_core",
        "physics.without_contacts_env_steps_per_s_per_core",
        "physics.core_gflop_per_s",
        "rollout.core_gflop_per_s",
        "rollout.pair_gflop_per_s",
        "rollout.env_steps_per_s_per_core",
        "rollout.physics_us",
        "rollout.policy_us",
        "rollout.observe_us",
        "rollout.2x256.env_steps_per_s_per_core",
        "rollout.2x128.env_steps_per_s_per_core",
        "learner.env_steps_per_s",
        "learner.floor_env_steps_per_s",
        "learner.mflop_per_env_step",
        "learner.best_env_steps_per_s",
        "learner.f32.product_gflop_per_s",
        "learner.bf16.product_gflop_per_s",
        "learner.f32.env_steps_per_s",
        "learner.bf16.env_steps_per_s",
        "learner.2x256.env_steps_per_s",
        "learner.2x128.env_steps_per_s",
        "learner.2x256.product_gflop_per_s",
        "learner.2x128.product_gflop_per_s",
        "transport.p50_us",
        "transport.p99_us",
        "transport.floor_p99_us",
        "transport.pipe_p99_us",
        "transport.unix_socket_p99_us",
        "transport.sender_cpu_us_per_block",
        "transport.receiver_cpu_us_per_block",
        "train.env_steps_per_s",
        "memory.rss_mib",
        "memory.pss_mib",
        "memory.learner.rss_mib",
        "memory.worker_0.rss_mib",
        "memory.coordinator.rss_mib",
    ] {
        let value = figures[key].as_f64();
        assert!(value.is_some_and(|value| value > 0.0 && value.is_finite()), "{key}: {value:?}");
    }
    let number = |key: &str| figures[key].as_f64().expect("a number");
    // One decision for the update and its floor, and the one that a run would begin with.
    let decided = figures["config"]["run"]["precision"].as_str().expect("a name");
    let same = |name: &str| {
        number(&format!("learner.{decided}.{name}")) == number(&format!("learner.{name}"))
    };
    assert!(same("env_steps_per_s") && same("floor_env_steps_per_s"), "{decided}: {figures}");
    assert_eq!(figures["preset"], "paper");
    for share in ["others_share", "stolen_share"] {
        let share = figures["load"][share].as_f64().expect("a share");
        assert!((0.0..=1.0).contains(&share), "{}", figures["load"]);
    }
    assert!(number("transport.p50_us") <= number("transport.p99_us"));
    assert!(number("memory.pss_mib") <= number("memory.rss_mib"));
    assert!(is_empty(dir.path()), "the temporary directory is removed");
    let domains = domains(&stderr(&output));
    assert!(!domains.is_empty(), "the log names the domain: {}", stderr(&output));
    for domain in &domains {
        assert_nothing_left(domain);
    }
}

/// A learner that says it is faster than its own products.
#[test]
fn measurements_that_contradict_each_other_are_not_shown() {
    let octopus = program("octopus");
    let beside = octopus.parent().expect("a directory");
    // Beside the programs, so that links work: octopus takes the learner next to itself.
    let dir = tempfile::tempdir_in(beside).expect("a directory");
    std::fs::hard_link(&octopus, dir.path().join("octopus")).expect("linked");
    std::fs::hard_link(program("sim-worker"), dir.path().join("sim-worker")).expect("linked");
    let learner = dir.path().join("learner");
    let said = r#"{"env_steps_per_s":1e9,"best_env_steps_per_s":1e9,"precision":"f32",
        "mflop_per_env_step":1.0,"state_bytes":1.0,"product_gflop_per_s":1.0}"#;
    std::fs::write(&learner, format!("#!/bin/sh\necho '{said}'\n")).expect("written");
    std::fs::set_permissions(&learner, Permissions::from_mode(0o755)).expect("its file");
    let mut command = Command::new(dir.path().join("octopus"));
    command.args(["bench", "learner", "--seconds=0.05"]).args(SMALL).stdin(Stdio::null());
    let output = command.output().expect("octopus starts");
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("contradict each other, so that none is shown"), "{message}");
    assert!(message.contains("learner.2x256.env_steps_per_s: measured"), "{message}");
    assert!(output.stdout.is_empty(), "no table");
}

#[test]
fn the_table_of_a_measurement_fits_in_80_columns() {
    let dir = tempfile::tempdir().expect("a directory");
    let output = consistent(|| bench(dir.path(), &["physics", "--seconds=0.05"]));
    let table = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(table.contains("meanwhile other programs had"), "{table}");
    for line in table.lines() {
        assert!(line.chars().count() <= 80, "{line}\nis too long in\n{table}");
    }
}

#[test]
fn ctrl_c_ends_a_measured_training_and_removes_it() {
    let dir = tempfile::tempdir().expect("a directory");
    let mut command = bench(dir.path(), &["train", "--seconds=3000", "--workers=1"]);
    let mut process = Owned::spawn(command.stderr(Stdio::null()).stdout(Stdio::null()));
    let watchdog = Instant::now() + Duration::from_mins(2);
    let domain = loop {
        if let Some(domain) = lock_of_a_run(dir.path()) {
            break domain;
        }
        let ended = process.ended();
        assert!(ended.is_none() && Instant::now() < watchdog, "no run begins: {ended:?}");
        std::thread::sleep(Duration::from_millis(20));
    };
    kill(process.id(), Signal::INT);
    let status = loop {
        if let Some(status) = process.ended() {
            break status;
        }
        assert!(Instant::now() < watchdog, "it does not end");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(130));
    assert_nothing_left(&domain);
    assert!(is_empty(dir.path()), "the run directory is removed");
}

/// The domain of the run below `dir` that has trained on something.
fn lock_of_a_run(dir: &Path) -> Option<String> {
    let below = |dir: &Path| Some(std::fs::read_dir(dir).ok()?.flatten().map(|entry| entry.path()));
    let run = below(dir)?
        .find_map(|scratch| {
            below(&scratch)?.find(|path| {
                path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("train-"))
            })
        })?
        .join("run");
    let metrics = std::fs::read_to_string(run.join("metrics.jsonl")).ok()?;
    metrics.lines().next()?;
    let lock: Value = serde_json::from_slice(&std::fs::read(run.join("run.lock")).ok()?).ok()?;
    lock["domain"].as_str().map(str::to_owned)
}

#[test]
fn bad_input_is_refused_before_anything_is_measured() {
    for (args, code, said) in [
        (
            vec!["bench", "physics", "--peer", "--python=/nonexistent/python"],
            4,
            "make venv-benches",
        ),
        (vec!["bench", "growth", "--peer"], 2, "--peer"),
        (vec!["bench", "physics", "--pictures=/tmp/never"], 2, "growth"),
        (vec!["bench", "--seconds=0"], 2, "above 0"),
        (vec!["bench", "--set=network.hiden=[1]"], 3, "hidden"),
        (vec!["bench", "--set=robot.description=none.toml"], 3, "none.toml"),
        (vec!["bench", "speed"], 2, "growth"),
    ] {
        let output = octopus(&args);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(said), "{args:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty());
    }
}
