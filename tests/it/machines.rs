//! Machines that help a run, for tests: all of them are this one.

use std::net::{TcpListener, UdpSocket};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use tempfile::TempDir;
use tests::{Owned, Run, kill, processes_with, program};

/// An endpoint at which nobody listens.
pub(crate) fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    format!("tcp/{}", listener.local_addr().expect("bound"))
}

/// The same for encrypted links.
pub(crate) fn free_quic_endpoint() -> String {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    format!("quic/{}", socket.local_addr().expect("bound"))
}

/// A machine that helps: `octopus join` with a directory of its own.
pub(crate) struct Machine {
    pub(crate) dir: TempDir,
    pub(crate) process: Owned,
}

impl Machine {
    pub(crate) fn join(endpoint: &str, more: &[&str]) -> Self {
        Self::with(&program("octopus"), endpoint, more)
    }

    pub(crate) fn with(octopus: &Path, endpoint: &str, more: &[&str]) -> Self {
        Self::behind(Command::new(octopus), endpoint, more)
    }

    /// Its workers have a fault, see `sim-worker`'s `fault_injection.rs`.
    pub(crate) fn with_fault(endpoint: &str, fault: &str, more: &[&str]) -> Self {
        let mut command = Command::new(program("octopus"));
        command.env("SPACEOCTOPUS_TEST_FAULT", fault);
        Self::behind(command, endpoint, more)
    }

    /// Joins by `command`, which is `octopus` or becomes it.
    pub(crate) fn behind(mut command: Command, endpoint: &str, more: &[&str]) -> Self {
        let dir = tempfile::tempdir().expect("a temporary directory");
        let log = std::fs::File::create(dir.path().join("log")).expect("writable");
        command.args(["join", endpoint]).args(more).env("TMPDIR", dir.path());
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        let process = Owned::spawn(&mut command);
        Self { dir, process }
    }

    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(self.dir.path().join("log")).unwrap_or_default()
    }

    /// Its processes, by program name.
    pub(crate) fn children(&self, name: &str) -> Vec<u32> {
        let of = processes_with(self.dir.path().to_str().expect("UTF-8")).into_iter();
        of.filter(|(_, program)| program == name).map(|(pid, _)| pid).collect()
    }

    /// The name of its shared memory, from the command line of its workers.
    pub(crate) fn domain(&self) -> String {
        let worker = self.until("it has a worker", |machine| machine.children("sim-worker").pop());
        let line = std::fs::read(format!("/proc/{worker}/cmdline")).expect("it lives");
        let line = String::from_utf8_lossy(&line).into_owned();
        let mut words = line.split('\0').skip_while(|word| *word != "--domain");
        words.nth(1).expect("its domain").to_owned()
    }

    pub(crate) fn until<T>(&self, what: &str, seen: impl Fn(&Self) -> Option<T>) -> T {
        let watchdog = Instant::now() + Duration::from_mins(1);
        loop {
            if let Some(seen) = seen(self) {
                return seen;
            }
            assert!(Instant::now() < watchdog, "never: {what}; its log:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Waits until it has ended by itself: its exit code and its log.
    pub(crate) fn ended(&mut self) -> (Option<i32>, String) {
        (self.process.code(), self.log())
    }

    /// Has it leave by Ctrl-C, in order.
    pub(crate) fn leave(&mut self) {
        kill(self.process.id(), Signal::INT);
        self.ends_well("left the run");
    }

    /// Waits until the run is over and it has ended in order.
    pub(crate) fn succeed(&mut self) {
        self.ends_well("the run is over");
    }

    fn ends_well(&mut self, last: &str) {
        let watchdog = Instant::now() + Duration::from_mins(1);
        while self.process.ended().is_none() {
            assert!(Instant::now() < watchdog, "it does not end; its log:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(10));
        }
        assert!(self.process.succeeded(), "its log:\n{}", self.log());
        assert!(self.log().contains(last), "{}", self.log());
    }
}

/// A run that other machines may join.
pub(crate) fn open(endpoint: &str, more: &[&str]) -> Run {
    let listen = format!("--listen-workers={endpoint}");
    let flags: Vec<_> = [listen.as_str()].into_iter().chain(more.iter().copied()).collect();
    Run::train(&flags)
}

/// Digests of a run on one machine.
pub(crate) fn alone(iterations: u32) -> Vec<String> {
    let mut run = Run::train(&["--workers=2", &format!("--iterations={iterations}")]);
    run.succeed();
    run.digests()
}

/// Waits until the run's log says something, so many times.
pub(crate) fn wait_for(run: &mut Run, said: &str, times: usize) {
    let watchdog = Instant::now() + Duration::from_mins(1);
    while run.log().matches(said).count() < times {
        let log = run.log();
        assert!(run.ended().is_none(), "the run ended without {said:?}; its log:\n{log}");
        assert!(Instant::now() < watchdog, "never said {said:?}; its log:\n{log}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

pub(crate) fn assert_adds_up(run: &Run) {
    for line in run.metrics() {
        let steps = |key: &str| line["accounting"][key].as_u64().expect("a count");
        let known = steps("trained") + steps("duplicate") + steps("lost");
        assert_eq!(steps("produced"), known, "{line}");
        assert_eq!(steps("trained"), 128);
    }
}

/// The learner stands still, and with it the run: machines have time to come.
pub(crate) fn hold(run: &mut Run) -> u32 {
    let watchdog = Instant::now() + Duration::from_mins(1);
    loop {
        if let Some(&learner) = run.children("learner").first() {
            kill(learner, Signal::STOP);
            return learner;
        }
        assert!(Instant::now() < watchdog, "no learner; log:\n{}", run.log());
        std::thread::sleep(Duration::from_millis(1));
    }
}
