//! This machine helps a run of another one: `octopus join`.
//!
//! For the workers of this machine it is what the coordinator is at home: it creates the channels, starts the workers
//! and replaces those that die or fall silent. What they are ordered comes from a child, the gateway, which alone speaks
//! with the run; see the crate `gateway`.
//!
//! Nothing that happens here is for ever: configuration and robot come from the run and lie in a directory that goes
//! away with the membership. When the gateway dies, or the run has begun anew without this machine, the membership ends
//! and another one begins, with workers that know nothing of before.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use channels::{ChannelSizes, Channels, Domain, Role};
use proto::config::Config;
use proto::gateway::{Place, Said};
use proto::layout::Dimensions;
use proto::message::{HostId, Status};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use simulator::robot::Robot;

use crate::preflight::{self, Verdict};
use crate::signals::StopRequests;
use crate::supervisor::{Death, Programs, Supervisor, child_exit_code, log_tail};
use crate::{environment, signal_isolation};

/// What is needed to join.
#[derive(Debug)]
pub struct JoinSpec {
    /// Where the run is: `quic/HOST:PORT` or `tcp/ADDRESS:PORT`.
    pub endpoint: String,
    /// Certificates, for `quic`.
    pub certificates: Option<PathBuf>,
    /// Workers of this machine.
    pub workers: usize,
    /// What it calls itself.
    pub name: String,
    /// How long the run may be silent.
    pub wait: Duration,
    /// The program `gateway`.
    pub gateway: PathBuf,
    /// The program of the workers.
    pub programs: Programs,
    /// Ctrl-C.
    pub stop: StopRequests,
}

/// Why this machine helps no longer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Left {
    /// The run is over.
    Over,
    /// Ctrl-C.
    Asked,
}

/// How a membership ended.
enum Ended {
    Left(Left),
    /// The run goes on, or may; here is what happened.
    Lost(String),
}

/// How long the loop sleeps at most: bounds the time until a death is noticed.
const TICK: Duration = Duration::from_millis(20);
/// Pause before this machine joins again.
const PAUSE: Duration = Duration::from_millis(500);
/// How long a worker may take at least until it is ready.
const START_DEADLINE: Duration = Duration::from_secs(10);
/// Memberships in a row without one block that end it.
const MAX_FRUITLESS: u32 = 20;

/// Helps until the run is over, Ctrl-C, or an error. Whatever happens, no process and no shared memory is left when
/// this returns. `note` tells the owner what happens.
pub fn join(spec: &JoinSpec, note: &mut dyn FnMut(&str)) -> Result<Left, ExitError> {
    let mut fruitless = 0;
    loop {
        let mut blocks = 0;
        match membership(spec, &mut blocks, note)? {
            Ended::Left(left) => return Ok(left),
            Ended::Lost(why) => {
                fruitless = if blocks > 0 { 0 } else { fruitless + 1 };
                if fruitless >= MAX_FRUITLESS {
                    let message = format!(
                        "{}: joined {fruitless} times in a row without making a block; the last \
                         time: {why}",
                        spec.endpoint
                    );
                    return Err(ExitError::new(ExitCode::Child, message));
                }
                note(&format!("{why}; joining again"));
                std::thread::sleep(PAUSE);
            }
        }
    }
}

/// From joining to whatever ends it. Counts the blocks that are made.
fn membership(
    spec: &JoinSpec,
    blocks: &mut u64,
    note: &mut dyn FnMut(&str),
) -> Result<Ended, ExitError> {
    let unmade = |error: std::io::Error| {
        let message = format!(
            "{}: no temporary directory can be made: {error}; TMPDIR names another place",
            std::env::temp_dir().display()
        );
        ExitError::new(ExitCode::Environment, message)
    };
    let dir = tempfile::Builder::new().prefix("octopus-join-").tempdir().map_err(unmade)?;
    let run_dir = RunDir::new(dir.path());
    std::fs::create_dir(run_dir.logs()).map_err(unmade)?;
    let mut gateway = Gateway::start(spec, &run_dir)?;
    let host = loop {
        match gateway.wait(TICK) {
            Some(Word::Joined(host)) => break host,
            Some(Word::Ended(code, why)) => return Err(ExitError::new(code, why)),
            None if spec.stop.count() > 0 => return Ok(Ended::Left(Left::Asked)),
            None => {}
        }
    };
    let (config, robot) = settle(spec, &run_dir)?;
    let dimensions = Dimensions::new(&config, robot.n_arms);
    let room = preflight::shared_memory(&config, &dimensions, &["--workers"]);
    if room.verdict == Verdict::Failure {
        return Err(ExitError::new(ExitCode::Environment, room.sentence()));
    }
    let domain = Domain::fresh();
    let sizes = ChannelSizes::new(&config, &dimensions);
    let programs = spec.programs.clone();
    let mut supervisor =
        Supervisor::new(programs, run_dir, domain.clone(), &config.run, sizes.max_workers)?;
    note(&format!(
        "host {host} of the run at {}, with {}",
        spec.endpoint,
        output::counted(spec.workers as u64, "worker")
    ));
    let place = Place { domain: domain.as_str().to_owned(), arms: robot.n_arms };
    let mut host = Host { spec, config: &config, heard: BTreeMap::new(), blocks };
    let result = Channels::create(&domain, sizes)
        .map_err(ExitError::from)
        .and_then(|channels| host.serve(&channels, &place, &mut gateway, &mut supervisor, note));
    // Before its services are removed.
    drop(gateway);
    supervisor.close();
    result
}

/// Reads what the gateway has put down, and makes it that of this machine: what concerns processes is decided here.
fn settle(spec: &JoinSpec, run_dir: &RunDir) -> Result<(Config, Robot), ExitError> {
    let foreign = |error: &dyn std::fmt::Display| {
        let message = format!("{}: what the run has sent cannot be used: {error}", spec.endpoint);
        ExitError::new(ExitCode::BadInput, message)
    };
    let (path, robot) = (run_dir.config(), run_dir.robot());
    let text = process::input::read_text(&path).map_err(|error| foreign(&error))?;
    let mut config =
        Config::from_resolved_toml(&text, "its config.toml").map_err(|error| foreign(&error))?;
    config.run.workers = spec.workers;
    config.run.pin = false;
    std::fs::write(&path, config.to_toml()).map_err(|error| foreign(&error))?;
    let text = process::input::read_text(&robot).map_err(|error| foreign(&error))?;
    let robot = Robot::from_toml(&text, Path::new("its robot.toml"));
    Ok((config, robot.map_err(|error| foreign(&error))?))
}

/// A membership that has begun.
struct Host<'a> {
    spec: &'a JoinSpec,
    config: &'a Config,
    /// When each worker was last heard.
    heard: BTreeMap<u32, Instant>,
    blocks: &'a mut u64,
}

impl Host<'_> {
    fn serve(
        &mut self,
        channels: &Channels,
        place: &Place,
        gateway: &mut Gateway,
        supervisor: &mut Supervisor,
        note: &mut dyn FnMut(&str),
    ) -> Result<Ended, ExitError> {
        let bell = channels.listener(Role::Coordinator)?;
        let words = channels.status_receiver()?;
        gateway.tell(place);
        supervisor.scale(self.spec.workers)?;
        loop {
            bell.wait(TICK);
            while let Some(status) = words.try_receive()? {
                self.hear(&status, supervisor, note);
            }
            self.replace_the_dead(channels, supervisor, note)?;
            match gateway.wait(Duration::ZERO) {
                None | Some(Word::Joined(_)) => {}
                Some(Word::Ended(ExitCode::Success, _)) => return Ok(Ended::Left(Left::Over)),
                // It may be better the next time, but not where this machine lacks something.
                Some(Word::Ended(ExitCode::Environment, why)) => {
                    return Err(ExitError::new(ExitCode::Environment, why));
                }
                Some(Word::Ended(_, why)) => return Ok(Ended::Lost(why)),
            }
            if self.spec.stop.count() > 0 {
                return Ok(Ended::Left(Left::Asked));
            }
        }
    }

    fn hear(&mut self, status: &Status, supervisor: &mut Supervisor, note: &mut dyn FnMut(&str)) {
        match status {
            Status::Ready { worker, incarnation, .. }
            | Status::Heartbeat { worker, incarnation, .. }
                if supervisor.is_current(*worker, *incarnation) =>
            {
                self.heard.insert(*worker, Instant::now());
            }
            Status::BlockDone { worker, .. } | Status::EvaluationDone { worker, .. } => {
                *self.blocks += 1;
                self.heard.insert(*worker, Instant::now());
                supervisor.worker_delivered(*worker);
            }
            Status::Failed { worker, message, .. } => note(&format!("worker {worker}: {message}")),
            _ => {}
        }
    }

    /// Reaps the dead, kills the silent and starts successors; the gateway sends them what is left undone.
    fn replace_the_dead(
        &mut self,
        channels: &Channels,
        supervisor: &mut Supervisor,
        note: &mut dyn FnMut(&str),
    ) -> Result<(), ExitError> {
        let deaths = supervisor.reap();
        if !deaths.is_empty() {
            channels.clean_up_after_the_dead();
        }
        for death in deaths {
            if let Death::Worker(worker, cause) = death {
                self.heard.remove(&worker);
                note(&format!("worker {worker} died ({cause}) and is replaced"));
                supervisor.check_deaths(worker, cause)?;
            }
        }
        supervisor.start_due()?;
        let deadline = Duration::from_secs_f64(self.config.run.order_deadline_s);
        let silent: Vec<_> = supervisor
            .running_since()
            .filter(|(worker, started)| match self.heard.get(worker) {
                Some(heard) => heard.elapsed() > deadline,
                None => started.elapsed() > deadline.max(START_DEADLINE),
            })
            .map(|(worker, _)| worker)
            .collect();
        for worker in silent {
            if supervisor.kill_worker(worker) {
                note(&format!("worker {worker} has been silent for too long"));
            }
        }
        Ok(())
    }
}

/// What is heard of the gateway.
enum Word {
    Joined(HostId),
    /// It has ended with this code, and why.
    Ended(ExitCode, String),
}

/// The child that speaks with the run. It is killed when this is dropped.
struct Gateway {
    child: Child,
    words: Receiver<Said>,
    log: PathBuf,
    /// Why it ends, as far as it has said so.
    why: Option<String>,
}

impl Gateway {
    fn start(spec: &JoinSpec, run_dir: &RunDir) -> Result<Self, ExitError> {
        let fail = |what: &str, error: &std::io::Error| {
            ExitError::new(ExitCode::Environment, format!("{what}: {error}"))
        };
        let log = run_dir.logs().join("gateway.log");
        let file = File::create(&log)
            .map_err(|error| fail(&format!("{}: cannot be written", log.display()), &error))?;
        let mut command = Command::new(&spec.gateway);
        environment::clean(&mut command);
        command.args(["host", "--connect", &spec.endpoint]);
        if let Some(dir) = &spec.certificates {
            command.arg("--certificates").arg(dir);
        }
        command
            .args(["--workers", &spec.workers.to_string()])
            .arg(format!("--name={}", spec.name))
            .args(["--wait", &spec.wait.as_secs_f64().to_string()])
            .arg("--sim-worker")
            .arg(&spec.programs.sim_worker)
            .arg("--run-dir")
            .arg(run_dir.path())
            .args(["--parent", &std::process::id().to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(file)
            // Ctrl-C on the terminal is not for it.
            .process_group(0);
        let mut child = signal_isolation::spawn(&mut command)
            .map_err(|error| fail("cannot start the gateway", &error))?;
        let (sender, words) = mpsc::channel();
        let out = child.stdout.take();
        let listen = move || {
            let lines = out.into_iter().flat_map(|out| BufReader::new(out).lines());
            for line in lines.map_while(Result::ok) {
                // What is no word of it, or comes when nobody listens, is for nobody.
                let said = serde_json::from_str(&line).ok();
                let _ = said.map(|said: Said| sender.send(said));
            }
        };
        let gateway = Self { child, words, log, why: None };
        std::thread::Builder::new()
            .name("gateway".to_owned())
            .spawn(listen)
            .map_err(|error| fail("cannot start a thread", &error))?;
        Ok(gateway)
    }

    /// Says where the services are. A gateway that is no more is noticed by itself.
    fn tell(&mut self, place: &Place) {
        if let (Some(pipe), Ok(text)) = (&mut self.child.stdin, serde_json::to_string(place)) {
            let _ = writeln!(pipe, "{text}");
        }
    }

    /// The next word, if one comes within `patience`.
    fn wait(&mut self, patience: Duration) -> Option<Word> {
        match self.words.recv_timeout(patience) {
            Ok(Said::Joined(host)) => return Some(Word::Joined(host)),
            Ok(Said::Failed(why)) => {
                self.why = Some(why);
                return None;
            }
            Err(RecvTimeoutError::Timeout) => return None,
            // Its standard output is closed: it ends, or has.
            Err(RecvTimeoutError::Disconnected) => {}
        }
        let status = self.child.try_wait().ok()??;
        Some(Word::Ended(code(status), self.reason(status)))
    }

    fn reason(&self, status: ExitStatus) -> String {
        self.why.clone().unwrap_or_else(|| {
            let last = log_tail(&self.log, 1);
            format!("the gateway ended ({status}): {last}")
        })
    }
}

/// What a gateway ended with; a signal is none of the codes.
fn code(status: ExitStatus) -> ExitCode {
    match status.code() {
        Some(0) => ExitCode::Success,
        Some(1) => ExitCode::Failure,
        _ => child_exit_code(status),
    }
}

impl Drop for Gateway {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
