//! The child processes of a run: started, watched, reaped, replaced.
//!
//! **Who starts up is not killed.** A worker that shall go before it is ready is asked again when it is: a
//! process that dies while it opens its channels leaves them half-made, and cleaning up after that waits.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use channels::Domain;
use process::originals::Originals;
use proto::config::Run;
use proto::message::WorkerId;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use service::live::Role;
use store::regular_files::{self, Links};

use self::deaths::{MAX_CRASHES, MAX_KILLS};
use self::gateway::Gateway;
use self::started_programs::StartedPrograms;
use crate::janitor::Janitor;
use crate::{environment, signal_isolation};

mod cause;
mod deaths;
mod gateway;
mod gateway_child;
mod process_view;
mod programs;
mod started_programs;

pub use self::cause::{Cause, child_exit_code, log_tail, log_tail_from};
pub use self::deaths::{Death, Deaths};
pub use self::gateway::GatewaySpec;
pub use self::process_view::ProcessView;
pub use self::programs::Programs;

/// What there is of a worker.
#[derive(Debug)]
enum WorkerState {
    /// A process. `hung` if it was killed for its silence.
    Running { child: Child, started: Instant, hung: bool },
    /// A process that has been asked to go, and is killed after a while.
    Leaving { child: Child, until: Instant },
    /// None yet: a process starts after this time, as soon as there is room for one.
    Due { after: Instant },
}

#[derive(Debug)]
struct WorkerSlot {
    state: WorkerState,
    incarnation: u32,
    /// Deaths in a row without a delivered block.
    deaths: Deaths,
}

/// All children of a run. [`Self::close`] ends them. Without it they die with the thread that started
/// them, as they asked the kernel to kill them then, and the janitor removes what is left.
#[derive(Debug)]
pub struct Supervisor {
    programs: Programs,
    /// What nobody may change while the run goes on.
    started: StartedPrograms,
    originals: Originals,
    run_dir: RunDir,
    domain: Domain,
    /// Settings of the learner's numerical libraries.
    threads: usize,
    pin: bool,
    /// Workers that the channels have room for, those on their way out included.
    max_workers: usize,
    janitor: Janitor,
    learner: Option<Child>,
    learner_hung: bool,
    learner_replaced: u32,
    /// What carries the run to other machines, if it is open to them.
    gateway: Option<Gateway>,
    workers: BTreeMap<WorkerId, WorkerSlot>,
    /// Incarnations that workers will have when they start next; never used twice in a run.
    incarnations: BTreeMap<WorkerId, u32>,
    /// How often each worker has died and been replaced, and all together.
    replaced: BTreeMap<WorkerId, u32>,
    restarts: u64,
}

/// How long a worker that was asked to go may take for the block at hand.
const LEAVE_DEADLINE: Duration = Duration::from_secs(30);

impl Supervisor {
    /// No children yet but the janitor. They must find configuration and robot in `run_dir` as `originals` are.
    pub fn new(
        programs: Programs,
        run_dir: RunDir,
        domain: Domain,
        run: &Run,
        max_workers: usize,
        originals: Originals,
    ) -> Result<Self, ExitError> {
        let janitor = Janitor::start(&domain).map_err(|error| {
            ExitError::new(ExitCode::Environment, format!("cannot start the janitor: {error}"))
        })?;
        Ok(Self {
            programs,
            started: StartedPrograms::default(),
            originals,
            run_dir,
            domain,
            threads: run.learner_threads,
            pin: run.pin,
            max_workers,
            janitor,
            learner: None,
            learner_hung: false,
            learner_replaced: 0,
            gateway: None,
            workers: BTreeMap::new(),
            incarnations: BTreeMap::new(),
            replaced: BTreeMap::new(),
            restarts: 0,
        })
    }

    /// Starts the learner, from a training state if one is given.
    ///
    /// Children ask the kernel to be killed when the *thread* that started them ends, so this and
    /// [`Self::scale`] must be called from a thread that lives as long as the run.
    pub fn start_learner(&mut self, resume: Option<&Path>) -> Result<(), ExitError> {
        let mut command = Command::new(&self.programs.learner);
        if let Some(state) = resume {
            command.arg("--resume").arg(state);
        }
        environment::set_numerical(&mut command, self.threads);
        self.learner_hung = false;
        self.learner = Some(self.spawn(command, "learner.log")?);
        Ok(())
    }

    /// Has `n` workers stay: starts what is missing as soon as the channels have room for it, and
    /// lets the youngest go. Returns those that the caller must ask to go, with their incarnations:
    /// now, and again when one [becomes ready](Self::is_leaving) that was not, for it hears nothing
    /// before.
    pub fn scale(&mut self, n: usize) -> Result<Vec<(WorkerId, u32)>, ExitError> {
        let mut asked = Vec::new();
        // The youngest go first, so that numbers stay dense.
        let staying: Vec<_> = self.staying().collect();
        for &worker in staying.iter().skip(n).rev() {
            let Some(slot) = self.workers.remove(&worker) else { continue };
            let WorkerState::Running { child, .. } = slot.state else { continue };
            asked.push((worker, slot.incarnation));
            let state = WorkerState::Leaving { child, until: Instant::now() + LEAVE_DEADLINE };
            self.workers.insert(worker, WorkerSlot { state, ..slot });
        }
        // The number of one that is still on its way out is free only when it is gone.
        let missing = n.saturating_sub(staying.len());
        let free: Vec<_> =
            (0..).filter(|id| !self.workers.contains_key(id)).take(missing).collect();
        for worker in free {
            let state = WorkerState::Due { after: Instant::now() };
            let slot = WorkerSlot { state, incarnation: 0, deaths: Deaths::default() };
            self.workers.insert(worker, slot);
        }
        self.start_due()?;
        Ok(asked)
    }

    /// Refuses new workers that would be others than those before: [`Self::scale`] ends the run for one.
    pub fn may_add_workers(&mut self) -> Result<(), ExitError> {
        let program = &self.programs.sim_worker;
        program.metadata().map_err(|error| {
            let message = format!("cannot start {}: {error}", program.display());
            ExitError::new(ExitCode::Environment, message)
        })?;
        self.started.check(program)?;
        self.originals.check(&self.run_dir)
    }

    /// Workers that run or will run again, in order.
    fn staying(&self) -> impl Iterator<Item = WorkerId> {
        let stays = |slot: &WorkerSlot| !matches!(slot.state, WorkerState::Leaving { .. });
        self.workers.iter().filter(move |(_, slot)| stays(slot)).map(|(&worker, _)| worker)
    }

    fn start_worker(&mut self, worker: WorkerId, deaths: Deaths) -> Result<(), ExitError> {
        let next = self.incarnations.entry(worker).or_default();
        let incarnation = *next;
        *next += 1;
        let mut command = Command::new(&self.programs.sim_worker);
        environment::clean(&mut command);
        command.args(["--worker", &worker.to_string(), "--incarnation", &incarnation.to_string()]);
        if self.pin {
            command.args(["--pin", &worker.to_string()]);
        }
        let child = self.spawn(command, &format!("worker-{worker}.log"))?;
        let state = WorkerState::Running { child, started: Instant::now(), hung: false };
        self.workers.insert(worker, WorkerSlot { state, incarnation, deaths });
        Ok(())
    }

    fn spawn(&mut self, mut command: Command, log: &str) -> Result<Child, ExitError> {
        let path = self.run_dir.logs().join(log);
        let fail = |what: &str, error: &std::io::Error| {
            ExitError::new(ExitCode::Environment, format!("{what}: {error}"))
        };
        let mut options = File::options();
        options.create(true).append(true);
        let file =
            regular_files::open_with(&path, &mut options, Links::Follow).map_err(|error| {
                let message = format!("{}: cannot be written: {error}", path.display());
                ExitError::new(ExitCode::RunDirectory, message)
            })?;
        self.started.check(Path::new(command.get_program()))?;
        self.originals.tell(&mut command);
        let copy = file.try_clone().map_err(|error| fail("cannot share the log file", &error))?;
        command
            .arg("--run-dir")
            .arg(self.run_dir.path())
            .args(["--domain", self.domain.as_str()])
            .args(["--parent", &std::process::id().to_string()])
            .stdin(Stdio::null())
            .stdout(copy)
            .stderr(file)
            // Ctrl-C on the terminal is for the coordinator, who tells the others.
            .process_group(0);
        let child = signal_isolation::spawn(&mut command).map_err(|error| {
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
            self.learner_replaced += 1;
            deaths.push(Death::Learner(Cause::of(status, self.learner_hung)));
        }
        let now = Instant::now();
        deaths.extend(self.reap_gateway(now));
        let mut gone = Vec::new();
        for (&worker, slot) in &mut self.workers {
            match &mut slot.state {
                WorkerState::Due { .. } => {}
                WorkerState::Leaving { child, until } => {
                    if let Ok(Some(_)) = child.try_wait() {
                        gone.push(worker);
                        deaths.push(Death::Left(worker));
                    } else if now > *until {
                        let _ = child.kill();
                    }
                }
                WorkerState::Running { child, started, hung } => {
                    let Ok(Some(status)) = child.try_wait() else { continue };
                    let cause = Cause::of(status, *hung);
                    slot.deaths = slot.deaths.and(cause, started.elapsed());
                    let delay = slot.deaths.back_off();
                    slot.state = WorkerState::Due { after: now + delay };
                    deaths.push(Death::Worker(worker, cause));
                }
            }
        }
        for worker in gone {
            self.workers.remove(&worker);
        }
        deaths
    }

    /// Starts the workers that are due, as far as there is room for them. Returns those that
    /// replace a dead one.
    pub fn start_due(&mut self) -> Result<Vec<WorkerId>, ExitError> {
        let now = Instant::now();
        let lives = |slot: &&WorkerSlot| !matches!(slot.state, WorkerState::Due { .. });
        let room = self.max_workers.saturating_sub(self.workers.values().filter(lives).count());
        let is_due =
            |slot: &WorkerSlot| matches!(slot.state, WorkerState::Due { after } if after <= now);
        let due: Vec<_> = self
            .workers
            .iter()
            .filter(|(_, slot)| is_due(slot))
            .map(|(&worker, slot)| (worker, slot.deaths))
            .take(room)
            .collect();
        let mut replaced = Vec::new();
        for (worker, deaths) in due {
            self.start_worker(worker, deaths)?;
            if deaths.total() > 0 {
                self.restarts += 1;
                *self.replaced.entry(worker).or_default() += 1;
                replaced.push(worker);
            }
        }
        self.start_gateway_if_due(now)?;
        Ok(replaced)
    }

    /// Refuses to go on with a worker that dies again and again without delivering a block.
    pub fn check_deaths(&self, worker: WorkerId, cause: Cause) -> Result<(), ExitError> {
        let deaths = self.workers.get(&worker).map_or(Deaths::default(), |slot| slot.deaths);
        if !deaths.are_too_many(MAX_CRASHES, MAX_KILLS) {
            return Ok(());
        }
        let log = self.run_dir.logs().join(format!("worker-{worker}.log"));
        Err(ExitError::new(
            cause.exit_code(),
            format!(
                "worker {worker} died {} times in a row without delivering a block ({cause}); the \
                 end of {}:\n{}",
                deaths.total(),
                log.display(),
                log_tail(&log, 5)
            ),
        ))
    }

    /// A worker has delivered: what killed its predecessors is over.
    pub fn worker_delivered(&mut self, worker: WorkerId) {
        if let Some(slot) = self.workers.get_mut(&worker) {
            slot.deaths = Deaths::default();
        }
    }

    /// Nobody could be heard for so long: what is to happen by the clock happens so much later.
    pub fn postpone_deadlines(&mut self, late: Duration) {
        for slot in self.workers.values_mut() {
            match &mut slot.state {
                WorkerState::Running { started, .. } => *started += late,
                WorkerState::Leaving { until, .. } => *until += late,
                WorkerState::Due { .. } => {}
            }
        }
        if let Some(gateway) = &mut self.gateway {
            gateway.postpone(late);
        }
    }

    /// Workers that run and are to stay, and when they were started.
    pub fn running_since(&self) -> impl Iterator<Item = (WorkerId, Instant)> {
        self.workers.iter().filter_map(|(&worker, slot)| match slot.state {
            WorkerState::Running { started, .. } => Some((worker, started)),
            _ => None,
        })
    }

    /// Whether `incarnation` is the one that runs now: messages of the dead arrive late.
    pub fn is_current(&self, worker: WorkerId, incarnation: u32) -> bool {
        self.workers.get(&worker).is_some_and(|slot| {
            slot.incarnation == incarnation && matches!(slot.state, WorkerState::Running { .. })
        })
    }

    /// Whether `incarnation` is to go, and still runs.
    pub fn is_leaving(&self, worker: WorkerId, incarnation: u32) -> bool {
        self.workers.get(&worker).is_some_and(|slot| {
            slot.incarnation == incarnation && matches!(slot.state, WorkerState::Leaving { .. })
        })
    }

    /// Kills a worker that does not answer; [`Self::reap`] will find it. Whether it had to be.
    pub fn kill_worker(&mut self, worker: WorkerId) -> bool {
        if let Some(WorkerSlot { state: WorkerState::Running { child, hung, .. }, .. }) =
            self.workers.get_mut(&worker)
            && !*hung
        {
            *hung = true;
            let _ = child.kill();
            return true;
        }
        false
    }

    /// Kills a learner that does not answer; [`Self::reap`] will find it.
    pub fn kill_learner(&mut self) {
        if let Some(child) = &mut self.learner {
            self.learner_hung = true;
            let _ = child.kill();
        }
    }

    /// What a learner that has said why it fails ends with, if it ends within `patience`.
    pub fn learner_exit_code(&mut self, patience: Duration) -> ExitCode {
        let deadline = Instant::now() + patience;
        let Some(child) = &mut self.learner else { return ExitCode::Child };
        loop {
            match child.try_wait() {
                Ok(Some(status)) => return child_exit_code(status),
                Ok(None) if Instant::now() < deadline => {
                    std::thread::sleep(Duration::from_millis(5));
                }
                _ => return ExitCode::Child,
            }
        }
    }

    /// How many workers have been replaced.
    pub fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Every process, and every one to come.
    pub fn processes(&self) -> Vec<ProcessView> {
        let learner = ProcessView {
            role: Role::Learner,
            worker: None,
            pid: self.learner.as_ref().map(Child::id),
            replaced: self.learner_replaced,
            leaving: false,
        };
        let workers = self.workers.iter().map(|(&worker, slot)| {
            let (pid, leaving) = match &slot.state {
                WorkerState::Running { child, .. } => (Some(child.id()), false),
                WorkerState::Leaving { child, .. } => (Some(child.id()), true),
                WorkerState::Due { .. } => (None, false),
            };
            let replaced = self.replaced.get(&worker).copied().unwrap_or(0);
            ProcessView { role: Role::Worker, worker: Some(worker), pid, replaced, leaving }
        });
        let gateway = self.gateway.as_ref().map(Gateway::view);
        std::iter::once(learner).chain(gateway).chain(workers).collect()
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
            WorkerState::Running { child, .. } | WorkerState::Leaving { child, .. } => Some(child),
            WorkerState::Due { .. } => None,
        });
        let gateway = self.gateway.as_mut().and_then(Gateway::child);
        self.learner.iter_mut().chain(gateway).chain(workers)
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
        if let Some(gateway) = &mut self.gateway {
            gateway.is_dead();
        }
        self.workers.clear();
    }

    /// Kills what still runs, removes the domain's leftovers and sends the janitor home.
    pub fn close(mut self) {
        self.kill_all();
        match self.domain.remove_leftovers() {
            Ok(_) => self.janitor.dismiss(),
            // The janitor tries once more when its pipe is closed, which it is without that word.
            Err(error) => {
                tracing::warn!(%error, "shared memory of this run could not be removed");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt as _;
    use std::process::ExitStatus;

    use rustix::process::Signal;

    use super::*;

    fn deaths(cause: Cause, lived: Duration, times: u32) -> Deaths {
        (0..times).fold(Deaths::default(), |deaths, _| deaths.and(cause, lived))
    }

    #[test]
    fn who_hangs_again_and_again_is_given_up_however_long_silence_is_borne() {
        // A second more than the default of run.order_deadline_s, after which it is killed.
        let silent = deaths(Cause::Hang, Duration::from_secs(61), MAX_CRASHES);
        assert!(silent.are_too_many(MAX_CRASHES, MAX_KILLS), "{silent:?}");
        let crash = Cause::Crash(ExitStatus::from_raw(Signal::SEGV.as_raw()));
        let rare = deaths(crash, Duration::from_hours(1), 10 * MAX_CRASHES);
        assert_eq!(rare.total(), 1, "an hour of work lies between any two of them");
        let often = deaths(crash, Duration::from_secs(1), MAX_CRASHES);
        assert!(often.are_too_many(MAX_CRASHES, MAX_KILLS), "{often:?}");
    }
}
