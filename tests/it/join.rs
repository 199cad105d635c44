//! Other machines help: the same bits, whoever makes the blocks and whatever becomes of them.
//!
//! All of them are this machine, by the loopback address; a cable is a forwarder of this program, which can be pulled.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use tempfile::TempDir;
use tests::{Run, assert_nothing_left, kill, leftovers, octopus, program, stderr};

use crate::machines::{Machine, alone, assert_adds_up, free_endpoint, hold, open, wait_for};

#[test]
fn machines_that_help_change_no_bit() {
    for (machines, overlap) in [(1, "--overlap=0"), (2, "--overlap=1")] {
        let mut calm = Run::train(&["--workers=2", "--iterations=30", overlap]);
        calm.succeed();
        let endpoint = free_endpoint();
        let mut run = open(&endpoint, &["--workers=1", "--iterations=30", overlap]);
        let learner = hold(&mut run);
        let domain = run.domain_when_there();
        let mut helpers: Vec<_> =
            (0..machines).map(|_| Machine::join(&endpoint, &["--workers=2"])).collect();
        let domains: Vec<_> = helpers.iter().map(Machine::domain).collect();
        wait_for(&mut run, "helps with 2 workers", machines);
        kill(learner, Signal::CONT);
        run.succeed();
        helpers.iter_mut().for_each(Machine::succeed);
        assert_eq!(run.digests(), calm.digests(), "{machines} machines, {overlap}");
        let metrics = run.metrics();
        let made = metrics.iter().filter_map(|line| line["hosts"].as_object());
        let made: u64 =
            made.flat_map(|hosts| hosts.values()).filter_map(serde_json::Value::as_u64).sum();
        assert!(made > 0, "the metrics name no machine");
        assert_adds_up(&run);
        domains.iter().chain([&domain]).for_each(|domain| assert_nothing_left(domain));
    }
}

#[test]
fn a_run_without_workers_of_its_own_is_made_by_others_alone() {
    let expected = alone(20);
    let endpoint = free_endpoint();
    let more = ["--workers=1", "--iterations=20", "--set=run.evaluate_every=10"];
    let mut run = open(&endpoint, &more);
    let learner = hold(&mut run);
    run.domain_when_there();
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let mut helper = Machine::join(&endpoint, &["--workers=2", "--name=lab"]);
    wait_for(&mut run, "(lab) helps with 2 workers", 1);
    let scaled = octopus(&["scale", path, "0"]);
    assert!(scaled.status.success(), "{}", stderr(&scaled));
    wait_for(&mut run, "worker 0 has left", 1);
    // The status is a fraction of a second old.
    let host = helper.until("its run shows it", |_| {
        let status = octopus(&["status", path, "--json"]);
        let status: serde_json::Value = serde_json::from_slice(&status.stdout).ok()?;
        status.pointer("/live/hosts/0").cloned()
    });
    assert_eq!(host["name"], "lab", "{host}");
    let shown = octopus(&["status", path]);
    assert!(String::from_utf8_lossy(&shown.stdout).contains("1 lab"), "{}", stderr(&shown));
    kill(learner, Signal::CONT);
    run.succeed();
    helper.succeed();
    assert_eq!(run.digests(), expected);
    let evaluations = std::fs::read_to_string(run.path().join("evaluations.jsonl"));
    assert!(!evaluations.expect("was evaluated").is_empty());
}

#[test]
fn a_machine_can_be_given_more_workers_and_fewer_while_it_helps() {
    let expected = alone(30);
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=30"]);
    let learner = hold(&mut run);
    run.domain_when_there();
    let path = run.path();
    let path = path.to_str().expect("UTF-8");
    let mut helper = Machine::join(&endpoint, &["--workers=2", "--name=lab"]);
    let domain = helper.domain();
    wait_for(&mut run, "(lab) helps with 2 workers", 1);
    let scale = |count: &str, host: &str| {
        // The status, by which it is found, is a fraction of a second old.
        helper.until("its run takes it", |_| {
            let scaled = octopus(&["scale", path, count, "--host", host]);
            scaled.status.success().then(|| String::from_utf8_lossy(&scaled.stdout).into_owned())
        })
    };
    assert_eq!(scale("3", "lab").trim(), "3 workers of host lab instead of 2");
    wait_for(&mut run, "host 1 (lab) helps with 3 workers", 1);
    assert_eq!(scale("1", "1").trim(), "1 worker of host 1 instead of 3");
    wait_for(&mut run, "host 1 (lab) helps with 1 worker, before", 1);
    helper.until("two have left", |it| (it.log().matches("has left").count() == 2).then_some(()));
    for (args, said) in [
        (["scale", path, "2", "--host", "attic"], "there are 1 (lab)"),
        (["scale", path, "17", "--host", "lab"], "expected 1 to 16"),
        (["scale", path, "0", "--host", "lab"], "expected 1 to 16"),
    ] {
        let refused = octopus(&args);
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    }
    kill(learner, Signal::CONT);
    run.succeed();
    helper.succeed();
    assert_eq!(run.digests(), expected);
    assert_adds_up(&run);
    assert_nothing_left(&domain);
}

#[test]
fn a_run_that_begins_without_workers_waits_for_machines() {
    let expected = alone(20);
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &["--workers=0", "--iterations=20"]);
    wait_for(&mut run, "the run waits until a machine has joined", 1);
    let domain = run.domain_when_there();
    let path = run.path();
    let watchdog = Instant::now() + Duration::from_mins(1);
    loop {
        let status = octopus(&["status", path.to_str().expect("UTF-8"), "--json"]);
        let status = serde_json::from_slice::<serde_json::Value>(&status.stdout);
        if status.is_ok_and(|status| status["live"]["state"] == "waiting") {
            break;
        }
        assert!(Instant::now() < watchdog, "it does not wait; log:\n{}", run.log());
        std::thread::sleep(Duration::from_millis(10));
    }
    let mut helper = Machine::join(&endpoint, &["--workers=2"]);
    run.succeed();
    helper.succeed();
    assert_eq!(run.digests(), expected);
    assert_adds_up(&run);
    assert_nothing_left(&domain);
    // Without anybody who could join it, it would wait for ever.
    let refused = octopus(&["train", "--workers=0"]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("--listen-workers"), "{}", stderr(&refused));
}

#[test]
fn machines_that_come_and_go_change_no_bit() {
    let expected = alone(1000);
    let endpoint = free_endpoint();
    let deadline = "--set=run.order_deadline_s=3.0";
    let mut run = open(&endpoint, &["--workers=1", "--iterations=1000", deadline]);
    let domain = run.domain_when_there();
    let helper = Machine::join(&endpoint, &["--workers=2", "--name=helper"]);
    wait_for(&mut run, "host 1 (helper) helps with 2 workers", 1);
    let first = helper.domain();
    // Its worker is killed, which only itself notices.
    kill(helper.children("sim-worker")[0], Signal::KILL);
    helper.until("its worker is replaced", |it| it.log().contains("is replaced").then_some(()));
    // Its gateway is killed: it joins again, with workers of another domain.
    kill(helper.children("gateway")[0], Signal::KILL);
    wait_for(&mut run, "host 1 (helper) helps with 0 workers", 1);
    wait_for(&mut run, "host 2 (helper) helps with 2 workers", 1);
    assert_nothing_left(&first);
    let second = helper.domain();
    // Its gateway stands still: nobody waits for it, and it is taken back.
    let frozen = helper.children("gateway");
    for &pid in &frozen {
        kill(pid, Signal::STOP);
    }
    wait_for(&mut run, "host 2 (helper) helps with 0 workers", 1);
    for &pid in &frozen {
        kill(pid, Signal::CONT);
    }
    wait_for(&mut run, "host 2 (helper) helps with 2 workers", 2);
    // The whole machine is gone.
    let third = helper.domain();
    kill(helper.process.id(), Signal::KILL);
    wait_for(&mut run, "host 2 (helper) helps with 0 workers", 2);
    let mut another = Machine::join(&endpoint, &["--workers=1", "--name=another"]);
    wait_for(&mut run, "(another) helps with 1 worker", 1);
    // The gateway of the run itself: machines join its successor.
    kill(run.children("gateway")[0], Signal::KILL);
    wait_for(&mut run, "(another) helps with 1 worker", 2);
    let fourth = another.domain();
    // And the learner, with which all starts anew.
    kill(run.children("learner")[0], Signal::KILL);
    wait_for(&mut run, "(another) helps with 1 worker", 3);
    run.succeed();
    another.succeed();
    assert_eq!(run.digests(), expected);
    assert_adds_up(&run);
    for domain in [&domain, &first, &second, &third, &fourth] {
        assert_nothing_left(domain);
    }
}

/// A cable between a machine and the run.
struct Cable {
    endpoint: String,
    pulled: Arc<AtomicBool>,
}

impl Cable {
    fn to(endpoint: &str) -> Self {
        let far = endpoint.trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let endpoint = format!("tcp/{}", listener.local_addr().expect("bound"));
        let pulled = Arc::new(AtomicBool::new(false));
        let of = Arc::clone(&pulled);
        // Its threads end with the test program, or when both ends are closed.
        std::thread::spawn(move || {
            for near in listener.incoming().flatten() {
                let Ok(far) = TcpStream::connect(&far) else { continue };
                let ends = [(near.try_clone(), far.try_clone()), (Ok(far), Ok(near))];
                for (from, to) in ends {
                    let (from, to) = (from.expect("a socket"), to.expect("a socket"));
                    let pulled = Arc::clone(&of);
                    std::thread::spawn(move || carry(from, to, &pulled));
                }
            }
        });
        Self { endpoint, pulled }
    }

    /// From now on nothing comes through, and nobody is told.
    fn pull(&self) {
        self.pulled.store(true, Ordering::Relaxed);
    }

    fn plug_in(&self) {
        self.pulled.store(false, Ordering::Relaxed);
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, pulled: &AtomicBool) {
    let mut bytes = vec![0; 64 << 10];
    while let Ok(len) = from.read(&mut bytes) {
        while pulled.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(5));
        }
        if len == 0 || to.write_all(&bytes[..len]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
    let _ = from.shutdown(Shutdown::Both);
}

#[test]
fn a_cable_pulled_in_the_middle_costs_time_and_nothing_else() {
    let expected = alone(300);
    let endpoint = free_endpoint();
    let cable = Cable::to(&endpoint);
    let mut run = open(&endpoint, &["--workers=1", "--iterations=300"]);
    let mut helper = Machine::join(&cable.endpoint, &["--workers=2"]);
    wait_for(&mut run, "helps with 2 workers", 1);
    cable.pull();
    // The run goes on meanwhile, after a while without waiting for anybody.
    wait_for(&mut run, "helps with 0 workers, before 2", 1);
    let done = run.metrics().len();
    run.wait_for_iterations(done + 5);
    let learner = hold(&mut run);
    std::thread::sleep(Duration::from_secs(2));
    cable.plug_in();
    wait_for(&mut run, "helps with 2 workers", 2);
    kill(learner, Signal::CONT);
    run.succeed();
    helper.succeed();
    assert_eq!(run.digests(), expected);
    assert_adds_up(&run);
}

/// A processor that computes otherwise: its first block is compared before anything of it counts.
#[test]
fn a_machine_that_makes_other_bits_is_thrown_out_and_nothing_of_it_is_trained_on() {
    let expected = alone(300);
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=300"]);
    let learner = hold(&mut run);
    let domain = run.domain_when_there();
    let mut good = Machine::join(&endpoint, &["--workers=1", "--name=good"]);
    let mut bad = Machine::with_fault(&endpoint, "distort@*/*", &["--workers=2", "--name=bad"]);
    wait_for(&mut run, "(good) helps with 1 worker", 1);
    wait_for(&mut run, "(bad) helps with 2 workers", 1);
    kill(learner, Signal::CONT);
    wait_for(&mut run, "It is thrown out", 1);
    wait_for(&mut run, "(good) has made its first block", 1);
    let (path, learner) = (run.path(), hold(&mut run));
    let path = path.to_str().expect("UTF-8");
    let seen =
        good.until("the run says whom it has thrown out, and whose block was the same", |_| {
            let status = octopus(&["status", path, "--json"]);
            let status: serde_json::Value = serde_json::from_slice(&status.stdout).ok()?;
            let live = status["live"].clone();
            // What a run tells of itself is as old as its last report.
            let compared = live["hosts"][0]["compared"].as_u64() >= Some(1);
            (live["refused_hosts"][0]["name"] == "bad" && compared).then_some(live)
        });
    assert_eq!(seen["hosts"].as_array().map(Vec::len), Some(1), "{seen}");
    let shown = octopus(&["status", path]);
    let shown = String::from_utf8_lossy(&shown.stdout).into_owned();
    assert!(shown.contains("bad was thrown out"), "{shown}");
    kill(learner, Signal::CONT);
    assert_eq!(bad.ended().0, Some(4), "{}", bad.log());
    assert!(bad.log().contains("other bits"), "{}", bad.log());
    run.succeed();
    good.succeed();
    let log = run.log();
    assert!(log.contains("warning: host") && log.contains("(bad) made block"), "{log}");
    assert!(log.contains("nothing of it has been trained on"), "{log}");
    assert_eq!(run.digests(), expected);
    assert_adds_up(&run);
    assert_nothing_left(&domain);
}

/// A machine that is broken later is found by the share of its blocks that is compared, here all of them.
#[test]
fn a_machine_that_makes_other_bits_later_is_found_and_its_blocks_are_made_again() {
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=200", "--set=run.audit=1"]);
    let learner = hold(&mut run);
    let more = ["--workers=2", "--name=tired"];
    let mut helper = Machine::with_fault(&endpoint, "distort@20+/*", &more);
    wait_for(&mut run, "(tired) helps with 2 workers", 1);
    kill(learner, Signal::CONT);
    wait_for(&mut run, "(tired) has made its first block", 1);
    wait_for(&mut run, "It is thrown out", 1);
    assert_eq!(helper.ended().0, Some(4), "{}", helper.log());
    run.succeed();
    assert_eq!(run.metrics().len(), 200);
    assert_adds_up(&run);
}

/// The programs in a directory of their own, with a `sim-worker` that is another.
fn another_build() -> (TempDir, PathBuf) {
    let there = program("octopus");
    let target = there.parent().expect("a directory");
    let dir = tempfile::tempdir_in(target).expect("a directory beside the programs");
    for name in ["octopus", "gateway"] {
        std::fs::hard_link(target.join(name), dir.path().join(name)).expect("one disk");
    }
    let other = dir.path().join("sim-worker");
    std::fs::copy(target.join("sim-worker"), &other).expect("room");
    let mut file = std::fs::File::options().append(true).open(&other).expect("writable");
    file.write_all(b"\0").expect("room");
    let octopus = dir.path().join("octopus");
    (dir, octopus)
}

#[test]
fn a_machine_with_another_build_is_refused_with_what_differs() {
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=1000000"]);
    run.wait_for_iterations(1);
    let (_dir, other) = another_build();
    let mut refused = Machine::with(&other, &endpoint, &["--workers=1"]);
    let (code, log) = refused.ended();
    assert_eq!(code, Some(4), "{log}");
    assert!(log.contains("digest of the program sim-worker is"), "{log}");
    assert!(log.contains("same build"), "{log}");
    run.signal(Signal::INT);
    run.succeed();
}

#[test]
fn wrong_endpoints_are_refused_and_nobody_is_waited_for_for_ever() {
    let said = |args: &[&str]| {
        let output = octopus(args);
        (output.status.code(), stderr(&output))
    };
    let (code, text) = said(&["join", "tcp/10.1.2.3:7447"]);
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("--insecure"), "{text}");
    let (code, text) = said(&["train", "--listen-workers=tcp/0.0.0.0:7447"]);
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("neither encrypted"), "{text}");
    for wrong in ["127.0.0.1:7447", "tcp/127.0.0.1", "tls/127.0.0.1:7447"] {
        let (code, text) = said(&["join", wrong]);
        assert_eq!(code, Some(2), "{wrong}: {text}");
        assert!(text.contains("tcp/HOST:PORT"), "{wrong}: {text}");
    }
    // Nobody listens there.
    let endpoint = free_endpoint();
    let (code, text) = said(&["join", &endpoint, "--workers=1", "--wait=1s"]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains(&endpoint) && text.contains("--listen-workers"), "{text}");
    // Somebody does, but no run, and says nothing.
    let silent = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let endpoint = format!("tcp/{}", silent.local_addr().expect("bound"));
    let (code, text) = said(&["join", &endpoint, "--workers=1", "--wait=1s"]);
    assert_eq!(code, Some(1), "{text}");
    // And a run cannot listen there.
    let (code, text) =
        said(&["train", &format!("--listen-workers={endpoint}"), "--iterations=1", "--workers=1"]);
    assert_eq!(code, Some(4), "{text}");
    assert!(text.contains("cannot be listened at"), "{text}");
}

/// Ctrl-C at the run, or the time limit of a job: it goes on later, and those who helped are there again.
#[test]
fn a_run_that_is_stopped_before_its_budget_is_waited_for() {
    let expected = alone(40);
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=40"]);
    let learner = hold(&mut run);
    let mut helper = Machine::join(&endpoint, &["--workers=1", "--wait=2m"]);
    wait_for(&mut run, "helps with 1 worker", 1);
    run.signal(Signal::INT);
    kill(learner, Signal::CONT);
    assert_eq!(run.wait(), Some(0), "{}", run.log());
    let watchdog = Instant::now() + Duration::from_mins(1);
    while !helper.log().contains("the run was stopped before its budget was done; joining again") {
        assert!(Instant::now() < watchdog && helper.process.ended().is_none(), "{}", helper.log());
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(run.digests().len() < 40, "it was stopped");
    run.resume(&[&format!("--listen-workers={endpoint}"), "--workers=0"]);
    run.succeed();
    assert_eq!(run.digests(), expected);
    helper.succeed();
}

#[test]
fn a_killed_run_is_found_again_when_it_is_resumed() {
    let expected = alone(40);
    let endpoint = free_endpoint();
    let mut run = open(&endpoint, &["--workers=1", "--iterations=40"]);
    let learner = hold(&mut run);
    let mut helper = Machine::join(&endpoint, &["--workers=1"]);
    wait_for(&mut run, "helps with 1 worker", 1);
    kill(learner, Signal::CONT);
    run.wait_for_iterations(12);
    let domain = run.domain();
    run.signal(Signal::KILL);
    run.wait();
    assert_nothing_left(&domain);
    run.resume(&[&format!("--listen-workers={endpoint}")]);
    run.succeed();
    assert_eq!(run.digests(), expected);
    // It has joined again, or came too late and gives up.
    kill(helper.process.id(), Signal::INT);
    let watchdog = Instant::now() + Duration::from_mins(1);
    while helper.process.ended().is_none() {
        assert!(Instant::now() < watchdog, "{}", helper.log());
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(leftovers(&domain).is_empty());
}
