//! Signals to one process and to all, processes that stand still, and locks that somebody holds.

use std::fs::File;
use std::io::Write as _;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, OFlags, fcntl_getfl, fcntl_setfl, flock};
use rustix::pipe::fcntl_setpipe_size;
use rustix::process::Signal;
use serde_json::Value;
use tests::chaos::observe::everybody;
use tests::{
    HEARS_HANG_UPS, Owned, Run, SMALL, assert_nothing_left, kill, octopus, program, stderr,
};

/// Flags of a run that is not over before it is disturbed.
const LONG: &[&str] = &["--workers=2", "--iterations=100000", "--set=run.checkpoint_every=0"];

/// Iterations of the checkpoints of a run.
fn checkpoints(run: &Run) -> Vec<u64> {
    let path = run.path().join("checkpoints");
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut found: Vec<u64> = entries
        .filter_map(|entry| entry.file_name().to_str()?.strip_prefix("iteration-")?.parse().ok())
        .collect();
    found.sort_unstable();
    found
}

/// A run that is well under way, and its domain.
fn under_way(flags: &[&str]) -> (Run, String) {
    let mut run = Run::train(flags);
    let domain = run.domain_when_there();
    run.wait_for_iterations(3);
    (run, domain)
}

/// What must hold after a stop in order: no iteration is lost, and nothing left.
fn assert_stopped_in_order(run: &Run, domain: &str) {
    let iterations = run.metrics().len() as u64;
    assert_eq!(checkpoints(run), [iterations], "the current iteration is committed");
    assert_nothing_left(domain);
    let lock = std::fs::read_to_string(run.path().join("run.lock")).unwrap_or_default();
    assert_eq!(lock, "", "the lock names nobody");
}

#[test]
fn a_signal_to_all_processes_of_a_run_ends_it_with_a_checkpoint_of_the_current_iteration() {
    for signal in [Signal::TERM, Signal::INT, Signal::HUP] {
        let (mut run, domain) = under_way(LONG);
        // Children and janitor first, so that none of them hears of it from the coordinator.
        let coordinator = run.pid();
        let mut all = everybody(&run, std::slice::from_ref(&domain));
        all.retain(|pid| *pid != coordinator);
        assert!(all.len() >= 4, "learner, two workers and janitor: {all:?}");
        for pid in all {
            kill(pid, signal);
        }
        run.signal(signal);
        if signal == Signal::TERM {
            // From scripts that pass on what they hear.
            run.signal(signal);
            std::thread::sleep(Duration::from_millis(10));
            run.signal(signal);
        }
        assert_eq!(run.wait(), Some(0), "{signal:?}: {}", run.log());
        assert_stopped_in_order(&run, &domain);
    }
}

#[test]
fn a_closed_terminal_ends_a_run_in_order() {
    let mut run = Run::new();
    let dir = format!("--run-dir={}", run.path().display());
    let (reader, writer) = std::io::pipe().expect("a pipe");
    let mut command = Command::new(HEARS_HANG_UPS[0]);
    command.args(&HEARS_HANG_UPS[1..]).arg(program("octopus"));
    command.args(["train", "trajectory", &dir]).args(SMALL).args(LONG).stdin(Stdio::null());
    command.stdout(writer.try_clone().expect("a pipe")).stderr(writer);
    let mut process = Owned::spawn(&mut command);
    drop(command);
    let domain = run.domain_when_there();
    let patience = Instant::now() + Duration::from_mins(2);
    while run.metrics().len() < 3 {
        assert!(Instant::now() < patience && process.ended().is_none(), "no iterations");
        std::thread::sleep(Duration::from_millis(10));
    }
    // Nobody reads any more what it says.
    drop(reader);
    kill(process.id(), Signal::HUP);
    assert_eq!(process.code(), Some(0));
    assert_stopped_in_order(&run, &domain);
}

/// A terminal that is held with Ctrl-S, or `2>&1 | less`: whoever says something waits for ever, and so did
/// the thread that was to end the process all the same.
#[test]
fn a_second_request_ends_a_run_whose_standard_error_nobody_reads() {
    let run = Run::new();
    let dir = format!("--run-dir={}", run.path().display());
    let (reader, mut writer) = std::io::pipe().expect("a pipe");
    fcntl_setpipe_size(&writer, 4096).expect("a small pipe");
    let mut command = Command::new(program("octopus"));
    command.args(["train", "trajectory", &dir, "--quiet"]).args(SMALL).args(LONG);
    command.stdin(Stdio::null()).stdout(Stdio::null());
    command.stderr(writer.try_clone().expect("a pipe"));
    let mut process = Owned::spawn(&mut command);
    drop(command);
    let patience = Instant::now() + Duration::from_mins(2);
    while run.metrics().len() < 3 {
        assert!(Instant::now() < patience && process.ended().is_none(), "no iterations");
        std::thread::sleep(Duration::from_millis(10));
    }
    let domain = run.domain();
    // Full, to the last byte.
    let flags = fcntl_getfl(&writer).expect("a pipe");
    fcntl_setfl(&writer, flags | OFlags::NONBLOCK).expect("a pipe");
    while writer.write(b".").is_ok() {}
    fcntl_setfl(&writer, flags).expect("a pipe");
    for _ in 0..2 {
        kill(process.id(), Signal::TERM);
        std::thread::sleep(Duration::from_secs(1));
    }
    assert_eq!(process.code(), Some(130));
    drop(reader);
    assert_nothing_left(&domain);
}

#[test]
fn a_learner_that_dies_while_the_run_is_stopping_is_no_stop_in_order() {
    let (mut run, domain) = under_way(LONG);
    // Stands still, so that it cannot send its last snapshot.
    let learner = run.children("learner")[0];
    kill(learner, Signal::STOP);
    run.signal(Signal::TERM);
    std::thread::sleep(Duration::from_millis(300));
    kill(learner, Signal::KILL);
    assert_eq!(run.wait(), Some(6), "{}", run.log());
    let log = run.log();
    assert!(log.contains("died (signal 9) while the run was stopping"), "{log}");
    assert!(log.contains("octopus resume"), "{log}");
    assert_nothing_left(&domain);
}

#[test]
fn a_second_ctrl_c_ends_a_run_whose_store_is_locked_by_another() {
    let (mut run, domain) = under_way(LONG);
    let lock = run.path().join("checkpoints/.lock");
    let file = File::options().create(true).append(true).open(&lock).expect("writable");
    flock(&file, FlockOperation::LockExclusive).expect("free");
    let iterations = run.metrics().len();
    run.signal(Signal::INT);
    // The last snapshot has arrived and its commit waits for the lock.
    let patience = Instant::now() + Duration::from_mins(1);
    while !run.log().contains("stopping after this iteration") {
        assert!(Instant::now() < patience, "{}", run.log());
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(run.ended(), None, "there is no checkpoint yet");
    run.signal(Signal::INT);
    assert_eq!(run.wait(), Some(130), "{}", run.log());
    assert!(run.log().contains("stopped at once"), "{}", run.log());
    assert_nothing_left(&domain);
    assert_eq!(checkpoints(&run), [0; 0]);

    // Nobody holds it any more: the run goes on as if nothing had been.
    drop(file);
    run.resume(&[&format!("--iterations={}", iterations + 5)]);
    run.succeed();
}

#[test]
fn a_coordinator_that_stood_still_for_longer_than_its_deadlines_goes_on_with_its_processes() {
    let flags = ["--workers=2", "--iterations=150", "--set=run.order_deadline_s=1.5"];
    let mut calm = Run::train(&flags);
    calm.succeed();

    let (mut run, domain) = under_way(&flags);
    let children = || {
        let mut pids = run.children("sim-worker");
        pids.extend(run.children("learner"));
        pids.sort_unstable();
        pids
    };
    let before = children();
    run.signal(Signal::STOP);
    std::thread::sleep(Duration::from_secs(5));
    assert_eq!(children(), before, "they wait for it");
    run.signal(Signal::CONT);
    run.succeed();
    let log = run.log();
    assert!(!log.contains("replaced") && !log.contains("sent again"), "{log}");
    assert_eq!(run.metrics().last().expect("lines")["restarts"], 0);
    assert_eq!(run.digests(), calm.digests());
    assert_nothing_left(&domain);
}

/// The queue of what workers say holds half a minute of it: after that their first word was lost, nobody gave
/// them orders, and no deadline found that out.
#[test]
fn a_coordinator_stopped_while_workers_come_up_uses_them_afterwards() {
    let flags = ["--workers=2", "--iterations=40"];
    let mut calm = Run::train(&flags);
    calm.succeed();

    let mut run = Run::train(&flags);
    let domain = run.domain_when_there();
    let patience = Instant::now() + Duration::from_mins(1);
    while run.children("sim-worker").is_empty() {
        assert!(Instant::now() < patience, "{}", run.log());
        std::thread::sleep(Duration::from_millis(1));
    }
    run.signal(Signal::STOP);
    std::thread::sleep(Duration::from_secs(40));
    run.signal(Signal::CONT);
    run.succeed();
    assert_eq!(run.digests(), calm.digests());
    assert_nothing_left(&domain);
}

#[test]
fn more_workers_than_a_short_queue_has_room_for_get_all_their_orders() {
    let (run, domain) = {
        let mut run = Run::train(&[
            "--workers=33",
            "--iterations=4",
            "--set=env.n_envs=66",
            "--set=env.n_shards=66",
            "--set=task.episode_steps=2",
        ]);
        let domain = run.domain_when_there();
        run.succeed();
        (run, domain)
    };
    assert!(!run.log().contains("overdue"), "{}", run.log());
    assert_eq!(run.metrics().len(), 4);
    assert_nothing_left(&domain);
}

#[test]
fn a_deadline_shorter_than_signs_of_life_is_refused() {
    let run = Run::new();
    let dir = format!("--run-dir={}", run.path().display());
    let out = octopus(&["train", "trajectory", &dir, "--set=run.order_deadline_s=0.1"]);
    assert_eq!(out.status.code(), Some(3), "{}", stderr(&out));
    assert!(stderr(&out).contains("choose 1.5 s or more"), "{}", stderr(&out));
}

#[test]
fn a_training_that_diverges_says_so_at_once_and_in_the_end() {
    let mut run = Run::train(&[
        "--workers=2",
        "--iterations=4",
        "--set=optimizer.actor_lr=10.0",
        "--set=algorithm.max_kl=0.0",
        "--set=algorithm.epochs=4",
    ]);
    run.succeed();
    let log = run.log();
    assert!(log.contains("warning: the training has diverged in iteration"), "{log}");
    let path = run.path().display().to_string();
    let out = octopus(&["status", &path, "--json"]);
    let status: Value = serde_json::from_slice(&out.stdout).expect("JSON");
    assert!(
        status["divergence"]["reason"].as_str().expect("a reason").contains("nats"),
        "{status}"
    );
    let out = octopus(&["resume", &path, "--no-eval", "--iterations=5", "--quiet"]);
    assert!(out.status.success(), "{}", stderr(&out));
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(said.contains("the training has diverged in iteration"), "{said}");
}

/// Nothing but the rate is wrong, as in a first attempt: the preset's own limit on an update does not hide it.
#[test]
fn a_training_with_far_too_large_a_rate_ends_with_a_warning_on_standard_output() {
    let run = Run::new();
    let dir = format!("--run-dir={}", run.path().display());
    let own = [&*dir, "--workers=2", "--iterations=12", "--set=optimizer.actor_lr=10.0", "--quiet"];
    let args: Vec<&str> =
        ["train", "trajectory"].iter().chain(SMALL).chain(&own).copied().collect();
    let out = octopus(&args);
    assert!(out.status.success(), "{}", stderr(&out));
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    let warning = "warning: the training has diverged in iteration";
    assert_eq!(said.matches(warning).count(), 1, "{said}");
    assert!(stderr(&out).contains(warning), "{}", stderr(&out));
}
