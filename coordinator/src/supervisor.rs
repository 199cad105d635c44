//! The child processes of a run: started, watched, reaped, replaced.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use proto::channel::Domain;
use proto::message::WorkerId;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};

use crate::janitor::Janitor;

/// Where the programs of a run are.
#[derive(Debug, Clone)]
pub struct Programs {
    /// `learner`.
    pub learner: PathBuf,
    /// `sim-worker`.
    pub sim_worker: PathBuf,
}

impl Programs {
    /// Looks beside this program, then along `PATH`.
    pub fn find() -> Result<Self, ExitError> {
        Ok(Self { learner: find("learner")?, sim_worker: find("sim-worker")? })
    }
}

fn find(name: &str) -> Result<PathBuf, ExitError> {
    let beside = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(name)));
    let path = std::env::var_os("PATH").unwrap_or_default();
    beside
        .into_iter()
        .chain(std::env::split_paths(&path).map(|dir| dir.join(name)))
        .find(|candidate| candidate.is_file())
        .ok_or_else(|| {
            ExitError::new(
                ExitCode::Environment,
                format!("program `{name}` is neither beside octopus nor on PATH; run `make build`"),
            )
        })
}

/// A worker's process, or the time at which its successor starts.
#[derive(Debug)]
enum WorkerState {
    Running { child: Child, started: Instant },
    BackingOff { until: Instant },
}

#[derive(Debug)]
struct WorkerSlot {
    state: WorkerState,
    incarnation: u32,
    /// Deaths in a row without a delivered block.
    failures: u32,
}

/// A child that has ended by itself.
#[derive(Debug)]
pub enum Death {
    /// The learner.
    Learner(ExitStatus),
    /// A worker; its slot will start a successor.
    Worker(WorkerId, ExitStatus),
}

/// All children of a run. Dropping it kills and reaps them.
#[derive(Debug)]
pub struct Supervisor {
    programs: Programs,
    run_dir: RunDir,
    domain: Domain,
    janitor: Janitor,
    learner: Option<Child>,
    workers: BTreeMap<WorkerId, WorkerSlot>,
    restarts: u64,
}

/// Deaths of one worker in a row, without a block in between, after which the run is given up.
const MAX_FAILURES: u32 = 5;
/// First back-off; doubles with every failure in a row.
const BACK_OFF: Duration = Duration::from_millis(100);

impl Supervisor {
    /// No children yet but the janitor.
    pub fn new(programs: Programs, run_dir: RunDir, domain: Domain) -> Result<Self, ExitError> {
        let janitor = Janitor::start(&domain).map_err(|error| {
            ExitError::new(ExitCode::Environment, format!("cannot start the janitor: {error}"))
        })?;
        let (workers, restarts) = (BTreeMap::new(), 0);
        Ok(Self { programs, run_dir, domain, janitor, learner: None, workers, restarts })
    }

    /// Starts the learner, from a training state if one is given.
    ///
    /// Children ask the kernel to be killed when the *thread* that started them ends, so this and
    /// [`Self::start_workers`] must be called from a thread that lives as long as the run.
    pub fn start_learner(&mut self, resume: Option<&Path>) -> Result<(), ExitError> {
        let mut command = Command::new(&self.programs.learner);
        if let Some(state) = resume {
            command.arg("--resume").arg(state);
        }
        self.learner = Some(self.spawn(command, "learner.log")?);
        Ok(())
    }

    /// Starts workers 0 to `n` − 1.
    pub fn start_workers(&mut self, n: usize) -> Result<(), ExitError> {
        for worker in 0..n as WorkerId {
            let slot = self.start_worker(worker, 0, 0)?;
            self.workers.insert(worker, slot);
        }
        Ok(())
    }

    fn start_worker(
        &mut self,
        worker: WorkerId,
        incarnation: u32,
        failures: u32,
    ) -> Result<WorkerSlot, ExitError> {
        let mut command = Command::new(&self.programs.sim_worker);
        command.args(["--worker", &worker.to_string(), "--incarnation", &incarnation.to_string()]);
        let child = self.spawn(command, &format!("worker-{worker}.log"))?;
        let state = WorkerState::Running { child, started: Instant::now() };
        Ok(WorkerSlot { state, incarnation, failures })
    }

    fn spawn(&mut self, mut command: Command, log: &str) -> Result<Child, ExitError> {
        let path = self.run_dir.logs().join(log);
        let fail = |what: &str, error: &std::io::Error| {
            ExitError::new(ExitCode::Environment, format!("{what}: {error}"))
        };
        let file = File::options()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(|error| fail(&path.display().to_string(), &error))?;
        let copy = file.try_clone().map_err(|error| fail("cannot share the log file", &error))?;
        let child = command
            .arg("--run-dir")
            .arg(self.run_dir.path())
            .args(["--domain", self.domain.as_str()])
            .args(["--parent", &std::process::id().to_string()])
            .stdin(Stdio::null())
            .stdout(copy)
            .stderr(file)
            // Ctrl-C on the terminal is for the coordinator, who tells the others.
            .process_group(0)
            .spawn()
            .map_err(|error| {
                fail(&format!("cannot start {}", command.get_program().display()), &error)
            })?;
        self.janitor.watch(child.id());
        Ok(child)
    }

    /// Reaps whoever has ended.
    pub fn reap(&mut self) -> Vec<Death> {
        let mut deaths = Vec::new();
        if let Some(status) = self.learner.as_mut().and_then(|child| child.try_wait().ok()?) {
            self.learner = None;
            deaths.push(Death::Learner(status));
        }
        for (&worker, slot) in &mut self.workers {
            let WorkerState::Running { child, started } = &mut slot.state else { continue };
            let Ok(Some(status)) = child.try_wait() else { continue };
            // Who has worked for a while did not die of what killed it before.
            if started.elapsed() > Duration::from_mins(1) {
                slot.failures = 0;
            }
            slot.failures += 1;
            let delay = BACK_OFF * 2_u32.pow((slot.failures - 1).min(6));
            slot.state = WorkerState::BackingOff { until: Instant::now() + delay };
            deaths.push(Death::Worker(worker, status));
        }
        deaths
    }

    /// Starts the successors whose back-off is over. Returns them.
    pub fn replace_the_dead(&mut self) -> Result<Vec<WorkerId>, ExitError> {
        let now = Instant::now();
        let due: Vec<_> = self
            .workers
            .iter()
            .filter(
                |(_, slot)| matches!(slot.state, WorkerState::BackingOff { until } if until <= now),
            )
            .map(|(&worker, slot)| (worker, slot.incarnation + 1, slot.failures))
            .collect();
        for &(worker, incarnation, failures) in &due {
            if failures >= MAX_FAILURES {
                let log = self.run_dir.logs().join(format!("worker-{worker}.log"));
                return Err(ExitError::new(
                    ExitCode::Child,
                    format!(
                        "worker {worker} died {failures} times in a row without delivering a \
                         block; its log is {}",
                        log.display()
                    ),
                ));
            }
            let slot = self.start_worker(worker, incarnation, failures)?;
            self.workers.insert(worker, slot);
            self.restarts += 1;
        }
        Ok(due.into_iter().map(|(worker, ..)| worker).collect())
    }

    /// A worker has delivered: what killed its predecessors is over.
    pub fn worker_delivered(&mut self, worker: WorkerId) {
        if let Some(slot) = self.workers.get_mut(&worker) {
            slot.failures = 0;
        }
    }

    /// Whether `incarnation` is the one that runs now: messages of the dead arrive late.
    pub fn is_current(&self, worker: WorkerId, incarnation: u32) -> bool {
        self.workers.get(&worker).is_some_and(|slot| {
            slot.incarnation == incarnation && matches!(slot.state, WorkerState::Running { .. })
        })
    }

    /// Kills a worker that does not answer; [`Self::reap`] will find it.
    pub fn kill_worker(&mut self, worker: WorkerId) {
        if let Some(WorkerSlot { state: WorkerState::Running { child, .. }, .. }) =
            self.workers.get_mut(&worker)
        {
            let _ = child.kill();
        }
    }

    /// How many workers have been replaced.
    pub fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Waits up to `patience` for all children to end by themselves, then kills the rest.
    pub fn wait_for_all(&mut self, patience: Duration) {
        let deadline = Instant::now() + patience;
        while self.anybody_lives() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(5));
        }
        self.kill_all();
    }

    fn running(&mut self) -> impl Iterator<Item = &mut Child> {
        let workers = self.workers.values_mut().filter_map(|slot| match &mut slot.state {
            WorkerState::Running { child, .. } => Some(child),
            WorkerState::BackingOff { .. } => None,
        });
        self.learner.iter_mut().chain(workers)
    }

    fn anybody_lives(&mut self) -> bool {
        self.running().any(|child| matches!(child.try_wait(), Ok(None)))
    }

    /// Kills and reaps every child.
    pub fn kill_all(&mut self) {
        for child in self.running() {
            let _ = child.kill();
            let _ = child.wait();
        }
        self.learner = None;
        self.workers.clear();
    }

    /// Kills what still runs, removes the domain's leftovers and sends the janitor home.
    pub fn close(mut self) {
        self.kill_all();
        if let Err(error) = self.domain.remove_leftovers() {
            tracing::warn!(%error, "shared memory of this run could not be removed");
        }
        self.janitor.dismiss();
    }
}

/// How a child ended, in words.
pub fn describe(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => "unknown cause".to_owned(),
    }
}

/// The last lines of a child's log, to be shown with its death.
pub fn log_tail(path: &Path, lines: usize) -> String {
    let text = std::fs::read(path).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let tail: Vec<_> = text.lines().rev().take(lines).collect();
    tail.into_iter().rev().collect::<Vec<_>>().join("\n")
}
