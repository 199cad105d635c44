//! Several machines, each in a network of its own: what links and machines do, and that no bit changes by it.
//!
//! Where namespaces may not be made, nothing is tried, and what `join` tries on the loopback address has to do. With
//! `SPACEOCTOPUS_NET_TEST=1`, as `make net-test` does, a cable stays pulled for 90 s instead of 2.

use std::process::Command;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use tests::network::{Cable, Network};
use tests::{Run, assert_nothing_left, kill, program};

use crate::machines::{Machine, alone, assert_adds_up, hold, wait_for};

/// A run of a few iterations on machine 0.
fn run_on(network: &Network, iterations: u32, more: &[&str]) -> Run {
    let mut run = Run::new();
    let launcher = network.on(0);
    run.start_behind(&launcher.each_ref().map(String::as_str));
    let [listen, iterations] =
        [format!("--listen-workers={}", Network::endpoint()), format!("--iterations={iterations}")];
    let flags = ["--workers=1", &iterations, &listen, "--insecure"];
    run.start_training(&[&flags, more].concat());
    run
}

/// A machine that helps it, started by `launcher` on that machine.
fn join_behind(network: &Network, machine: usize, launcher: &[&str], more: &[&str]) -> Machine {
    let [first, rest @ ..] = network.on(machine);
    let mut command = Command::new(first);
    command.args(rest).args(launcher).arg(program("octopus"));
    let name = format!("--name=machine-{machine}");
    let flags = ["--insecure", &name];
    Machine::behind(command, &Network::endpoint(), &[&flags, more].concat())
}

/// One with a worker.
fn helper(network: &Network, machine: usize) -> Machine {
    join_behind(network, machine, &[], &["--workers=1"])
}

fn helps(machine: usize) -> String {
    format!("(machine-{machine}) helps with 1 worker")
}

fn is_gone(machine: usize) -> String {
    format!("(machine-{machine}) helps with 0 workers")
}

/// Its first block has been compared: from now on its work counts.
fn is_trusted(machine: usize) -> String {
    format!("(machine-{machine}) has made its first block")
}

/// A run that stands still after its first iteration, so that machines have time to come; and its learner.
fn held(network: &Network, iterations: u32, more: &[&str]) -> (Run, u32) {
    let mut run = run_on(network, iterations, more);
    run.wait_for_iterations(1);
    let learner = hold(&mut run);
    (run, learner)
}

/// Waits until the first blocks of these machines have been compared. Others may have taken all that was open before a machine
/// was there; then the run makes an iteration more.
fn until_trusted(run: &mut Run, learner: u32, machines: &[usize]) {
    let watchdog = Instant::now() + Duration::from_mins(1);
    while !machines.iter().all(|&machine| run.log().contains(&is_trusted(machine))) {
        assert!(run.ended().is_none(), "the run ended; its log:\n{}", run.log());
        assert!(Instant::now() < watchdog, "not all are trusted; its log:\n{}", run.log());
        std::thread::sleep(Duration::from_millis(500));
        kill(learner, Signal::CONT);
        run.wait_for_iterations(run.metrics().len() + 1);
        kill(learner, Signal::STOP);
    }
}

/// Has a held learner go on for an iteration every few seconds: one that stands still for long is taken for dead.
fn crawl(run: &mut Run, learner: u32, time: Duration) {
    const PAUSE: Duration = Duration::from_secs(3);
    let end = Instant::now() + time;
    while Instant::now() < end {
        let left = end.saturating_duration_since(Instant::now());
        std::thread::sleep(left.min(PAUSE));
        if left > PAUSE {
            kill(learner, Signal::CONT);
            run.wait_for_iterations(run.metrics().len() + 1);
            kill(learner, Signal::STOP);
        }
    }
}

/// Something that must end well, and does.
fn end(mut run: Run, helpers: &mut [Machine], expected: &[String]) {
    run.succeed();
    helpers.iter_mut().for_each(Machine::succeed);
    assert_eq!(run.digests(), expected);
    assert_adds_up(&run);
}

#[test]
fn delay_loss_and_narrow_links_change_no_bit() {
    let Some(mut network) = Network::new(4) else { return };
    let expected = alone(60);
    network.cable(1, Cable { delay_ms: 20.0, loss: 1.0, ..Cable::default() });
    network.cable(2, Cable { mbit: 20.0, ..Cable::default() });
    // Hosts have nothing to say to each other.
    network.part(1, 2);
    let (mut run, learner) = held(&network, 60, &[]);
    let mut helpers = [1, 2, 3].map(|machine| helper(&network, machine));
    until_trusted(&mut run, learner, &[1, 2, 3]);
    kill(learner, Signal::CONT);
    end(run, &mut helpers, &expected);
}

#[test]
fn a_link_between_two_networks_that_is_cut_changes_no_bit() {
    let Some(network) = Network::new(2) else { return };
    let expected = alone(100);
    let (mut run, learner) = held(&network, 100, &[]);
    let mut helpers = [join_behind(&network, 1, &[], &["--workers=2"])];
    wait_for(&mut run, "helps with 2 workers", 1);
    until_trusted(&mut run, learner, &[1]);
    kill(learner, Signal::CONT);
    run.wait_for_iterations(5);
    network.link(1, false);
    wait_for(&mut run, "helps with 0 workers, before 2", 1);
    let learner = hold(&mut run);
    std::thread::sleep(Duration::from_secs(2));
    network.link(1, true);
    wait_for(&mut run, "helps with 2 workers", 2);
    kill(learner, Signal::CONT);
    end(run, &mut helpers, &expected);
}

/// A block takes seconds on its way here, so that the cut is in the middle of one.
#[test]
fn a_cable_pulled_in_the_middle_of_a_block_costs_time_and_nothing_else() {
    let Some(mut network) = Network::new(2) else { return };
    let expected = alone(200);
    network.cable(1, Cable { mbit: 0.5, ..Cable::default() });
    let (mut run, learner) = held(&network, 200, &["--set=run.order_deadline_s=6.0"]);
    // It looks for the run for longer than the cable is pulled.
    let mut helpers = [join_behind(&network, 1, &[], &["--workers=1", "--wait=3m"])];
    until_trusted(&mut run, learner, &[1]);
    kill(learner, Signal::CONT);
    run.wait_for_iterations(run.metrics().len() + 1);
    network.link(1, false);
    wait_for(&mut run, &is_gone(1), 1);
    let learner = hold(&mut run);
    let long = std::env::var_os("SPACEOCTOPUS_NET_TEST").is_some();
    crawl(&mut run, learner, Duration::from_secs(if long { 90 } else { 2 }));
    network.cable(1, Cable { delay_ms: 1.0, ..Cable::default() });
    wait_for(&mut run, &helps(1), 2);
    kill(learner, Signal::CONT);
    end(run, &mut helpers, &expected);
}

/// Longer than a host waits for a run that it does not hear.
#[test]
fn a_machine_that_is_cut_off_for_good_leaves_and_the_run_goes_on() {
    let Some(network) = Network::new(2) else { return };
    let expected = alone(30);
    let mut run = run_on(&network, 30, &[]);
    let learner = hold(&mut run);
    let mut machine = join_behind(&network, 1, &[], &["--workers=1", "--wait=3s"]);
    wait_for(&mut run, &helps(1), 1);
    network.link(1, false);
    wait_for(&mut run, &is_gone(1), 1);
    kill(learner, Signal::CONT);
    end(run, &mut [], &expected);
    let (code, _) = machine.ended();
    assert_eq!(code, Some(1), "{}", machine.log());
}

#[test]
fn machines_stay_while_the_run_is_killed_and_resumed() {
    let Some(network) = Network::new(3) else { return };
    let expected = alone(300);
    let (mut run, learner) = held(&network, 300, &["--set=run.checkpoint_every_s=0.5"]);
    let mut helpers = [1, 2].map(|machine| helper(&network, machine));
    until_trusted(&mut run, learner, &[1, 2]);
    kill(learner, Signal::CONT);
    run.wait_for_iterations(run.metrics().len() + 1);
    let domain = run.domain();
    run.signal(Signal::KILL);
    run.wait();
    assert_nothing_left(&domain);
    // One of them is killed meanwhile, too, and joins again.
    kill(helpers[0].process.id(), Signal::KILL);
    helpers[0] = helper(&network, 1);
    let listen = format!("--listen-workers={}", Network::endpoint());
    run.resume(&[&listen, "--insecure"]);
    end(run, &mut helpers, &expected);
}

#[test]
fn a_full_disk_on_a_machine_is_its_own_trouble() {
    let Some(network) = Network::new(2) else { return };
    let mut run = run_on(&network, 1_000_000, &[]);
    run.wait_for_iterations(1);
    // A place for temporary files that is full before it begins. The mount is that of the namespace alone.
    let script = "mount -t tmpfs -o size=4k tmpfs /mnt && : > /mnt/full \
                  && head -c 4096 /dev/zero > /mnt/full; export TMPDIR=/mnt; exec \"$0\" \"$@\"";
    let mut machine =
        join_behind(&network, 1, &["sh", "-c", script], &["--workers=1", "--wait=5s"]);
    let (code, _) = machine.ended();
    assert_eq!(code, Some(4), "{}", machine.log());
    assert!(machine.log().contains("/mnt"), "{}", machine.log());
    let done = run.metrics().len();
    run.wait_for_iterations(done + 2);
    run.signal(Signal::INT);
    run.succeed();
}
