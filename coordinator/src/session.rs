//! The loop of a run: orders out, progress in, the dead replaced, snapshots committed.
//!
//! One thread owns all ports and children (iceoryx2's ports are single-threaded, and children die
//! with the thread that started them). It sleeps until the bell rings or a tick is over, then
//! looks at everything: status, progress, snapshot pieces, deaths, deadlines, stop requests. All
//! decisions about shards are the [`Scheduler`]'s, all handling of processes the [`Supervisor`]'s;
//! commits are written by a [`Committer`] thread, so the loop never waits for a disk.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use proto::channel::{
    BellListener, ChannelSizes, Channels, Domain, MessageReceiver, MessageSender, PieceReceiver,
    Role,
};
use proto::config::Config;
use proto::layout::Dimensions;
use proto::message::{IterationReport, Order, Progress, Status, WorkerId};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use sim_worker::robot::Robot;

use crate::checkpoint::{Assembly, Checkpoint, CheckpointStore};
use crate::committer::Committer;
use crate::report::{Live, Reporter};
use crate::scheduler::Scheduler;
use crate::signals::StopRequests;
use crate::supervisor::{Death, Programs, Supervisor, describe, log_tail};

/// Everything that a run needs to start or to go on. The run directory exists, holds
/// `config.toml` and `robot.toml`, and is locked.
#[derive(Debug)]
pub struct SessionSpec {
    /// Where results land.
    pub run_dir: RunDir,
    /// The resolved configuration.
    pub config: Config,
    /// The robot.
    pub robot: Robot,
    /// Where to go on from.
    pub resume: Option<Checkpoint>,
    /// The children's programs.
    pub programs: Programs,
    /// Written into every checkpoint.
    pub provenance: serde_json::Value,
    /// The name of the run's shared memory.
    pub domain: Domain,
    /// Ctrl-C.
    pub stop: StopRequests,
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StoppedBy {
    /// The planned env-steps are done.
    Budget,
    /// The time limit.
    TimeLimit,
    /// Ctrl-C.
    Signal,
}

/// How a run ended.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Iterations trained on, over all sessions of the run.
    pub iterations: u64,
    /// Env-steps trained on, over all sessions of the run.
    pub env_steps: u64,
    /// Why.
    pub stopped_by: StoppedBy,
    /// The last checkpoint.
    pub checkpoint: PathBuf,
}

/// How long the loop sleeps at most: bounds the time until a death is noticed.
const TICK: Duration = Duration::from_millis(20);
/// How long a learner or worker may take to come up.
const START_DEADLINE: Duration = Duration::from_mins(2);
/// How long the last snapshot may take, from the request to the committed checkpoint.
const FINISH_DEADLINE: Duration = Duration::from_mins(5);
/// How long children may take to exit after [`Order::Stop`].
const EXIT_DEADLINE: Duration = Duration::from_secs(5);

/// Runs until the budget, the time limit, a signal or an error ends it. Whatever happens, no
/// process and no shared memory is left when this returns.
pub fn run(spec: &SessionSpec, reporter: &mut Reporter) -> Result<Outcome, ExitError> {
    let mut supervisor =
        Supervisor::new(spec.programs.clone(), spec.run_dir.clone(), spec.domain.clone())?;
    let result = Session::start(spec, &mut supervisor)
        .and_then(|mut session| session.run(&mut supervisor, reporter));
    supervisor.close();
    result
}

/// The state of a run's loop.
struct Session<'a> {
    spec: &'a SessionSpec,
    channels: Channels,
    bell: BellListener,
    orders: MessageSender<Order>,
    progress: MessageReceiver<Progress>,
    status: MessageReceiver<Status>,
    pieces: PieceReceiver,
    assembly: Assembly,
    committer: Committer,
    /// Present once the learner is ready.
    scheduler: Option<Scheduler>,
    /// When each worker was last heard.
    heard: BTreeMap<WorkerId, Instant>,
    /// Workers that are ready before the learner is.
    early: Vec<(WorkerId, u32)>,
    /// Env-steps that workers said they produced, by iteration.
    produced: BTreeMap<u64, u64>,
    /// Env-steps that died with workers, by iteration.
    lost: BTreeMap<u64, u64>,
    /// Iterations reported.
    reported: u64,
    steps_per_block: u64,
    started: Instant,
    last_report: Instant,
    stopped_by: Option<StoppedBy>,
}

impl<'a> Session<'a> {
    fn start(spec: &'a SessionSpec, supervisor: &mut Supervisor) -> Result<Self, ExitError> {
        let dimensions = Dimensions::new(&spec.config, spec.robot.n_arms);
        let sizes = ChannelSizes::new(&spec.config, &dimensions);
        let channels = Channels::create(&spec.domain, sizes)?;
        let session = Self {
            bell: channels.listener(Role::Coordinator)?,
            orders: channels.order_sender()?,
            progress: channels.progress_receiver()?,
            status: channels.status_receiver()?,
            pieces: channels.snapshot_receiver()?,
            assembly: Assembly::new(),
            committer: Committer::start(
                CheckpointStore::new(spec.run_dir.checkpoints()),
                spec.config.clone(),
                spec.robot.to_toml(),
                spec.provenance.clone(),
            ),
            channels,
            scheduler: None,
            heard: BTreeMap::new(),
            early: Vec::new(),
            produced: BTreeMap::new(),
            lost: BTreeMap::new(),
            reported: 0,
            steps_per_block: (dimensions.n_envs * dimensions.n_steps) as u64,
            started: Instant::now(),
            last_report: Instant::now(),
            stopped_by: None,
            spec,
        };
        let state = spec.resume.as_ref().map(Checkpoint::state);
        supervisor.start_learner(state.as_deref())?;
        supervisor.start_workers(spec.config.run.workers)?;
        Ok(session)
    }

    fn run(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<Outcome, ExitError> {
        loop {
            self.bell.wait(TICK);
            self.tick(supervisor, reporter)?;
            self.check_stop(reporter);
            if self.scheduler.as_ref().is_some_and(Scheduler::is_finished) {
                break;
            }
        }
        self.finish(supervisor, reporter)
    }

    /// Looks at everything once.
    fn tick(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        if self.spec.stop.count() > 1 {
            return Err(ExitError::new(
                ExitCode::Interrupted,
                "stopped at once; the last checkpoint is where `octopus resume` goes on",
            ));
        }
        // Before the deaths: what a process said before it died still counts.
        self.hear_workers(supervisor, reporter)?;
        self.hear_learner(supervisor, reporter)?;
        self.collect_pieces()?;
        self.bury(supervisor, reporter)?;
        self.send_orders()?;
        self.check_deadlines(supervisor, reporter)
    }

    fn hear_workers(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let now = Instant::now();
        while let Some(status) = self.status.try_receive()? {
            match status {
                Status::Ready { worker, incarnation } => {
                    if !supervisor.is_current(worker, incarnation) {
                        continue;
                    }
                    self.heard.insert(worker, now);
                    match &mut self.scheduler {
                        Some(scheduler) => scheduler.worker_ready(worker, incarnation, now),
                        None => self.early.push((worker, incarnation)),
                    }
                }
                Status::Heartbeat { worker, incarnation } => {
                    if supervisor.is_current(worker, incarnation) {
                        self.heard.insert(worker, now);
                    }
                }
                Status::BlockDone { worker, incarnation, iteration, env_steps, .. } => {
                    *self.produced.entry(iteration).or_default() += env_steps;
                    if supervisor.is_current(worker, incarnation) {
                        self.heard.insert(worker, now);
                        supervisor.worker_delivered(worker);
                    }
                }
                Status::Failed { worker, message, .. } => {
                    reporter.note(&format!("worker {worker}: {message}"));
                }
                other => tracing::warn!(?other, "status of an unknown kind"),
            }
        }
        Ok(())
    }

    fn hear_learner(
        &mut self,
        supervisor: &Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let now = Instant::now();
        while let Some(progress) = self.progress.try_receive()? {
            match progress {
                Progress::Ready { iteration, digest, precision, .. } => {
                    tracing::info!(iteration, %digest, precision, "learner is ready");
                    self.learner_ready(iteration, now)?;
                }
                Progress::BlockReceived { iteration, shard, .. } => {
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.block_received((iteration, shard), now);
                    }
                }
                Progress::IterationDone(report) => {
                    self.iteration_done(*report, supervisor, reporter)?;
                }
                Progress::Failed { message } => {
                    return Err(ExitError::new(ExitCode::Child, format!("learner: {message}")));
                }
                other => tracing::warn!(?other, "progress of an unknown kind"),
            }
        }
        Ok(())
    }

    fn learner_ready(&mut self, iteration: u64, now: Instant) -> Result<(), ExitError> {
        let expected = self.spec.resume.as_ref().map_or(0, |from| from.manifest.iteration);
        if iteration != expected {
            return Err(ExitError::new(
                ExitCode::Child,
                format!("the learner starts at iteration {iteration} instead of {expected}"),
            ));
        }
        let config = &self.spec.config;
        let mut scheduler = Scheduler::new(
            config.env.n_shards as u32,
            config.run.overlap,
            iteration,
            config.planned_iterations().max(iteration),
        );
        for (worker, incarnation) in self.early.drain(..) {
            scheduler.worker_ready(worker, incarnation, now);
        }
        self.scheduler = Some(scheduler);
        self.reported = iteration;
        self.last_report = now;
        Ok(())
    }

    fn iteration_done(
        &mut self,
        mut report: IterationReport,
        supervisor: &Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let iteration = report.iteration;
        self.account(&mut report)?;
        let elapsed = self.last_report.elapsed().as_secs_f64();
        self.last_report = Instant::now();
        let live = Live {
            wall_s: self.started.elapsed().as_secs_f64(),
            env_steps_per_s: report.accounting.trained as f64 / elapsed,
            workers: self.spec.config.run.workers,
            restarts: supervisor.restarts(),
        };
        reporter.iteration(&report, &live).map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be written: {error:#}"))
        })?;
        self.reported = iteration + 1;
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.iteration_done(iteration);
            let every = self.spec.config.run.checkpoint_every;
            if every > 0 && (iteration + 1).is_multiple_of(every) && !scheduler.is_finished() {
                self.orders.send(&Order::Snapshot)?;
            }
        }
        Ok(())
    }

    /// Law 8: every env-step of the iteration is accounted for.
    fn account(&mut self, report: &mut IterationReport) -> Result<(), ExitError> {
        let iteration = report.iteration;
        let accounting = &mut report.accounting;
        let said = self.produced.remove(&iteration).unwrap_or(0);
        let died = self.lost.remove(&iteration).unwrap_or(0);
        // A worker that died between sending a block and saying so produced it all the same; one
        // that said so but whose block never arrived lost it.
        accounting.lost = died.max(said.saturating_sub(accounting.received));
        accounting.produced = accounting.received + accounting.lost;
        let planned = self.spec.config.steps_per_iteration();
        if accounting.trained != planned
            || accounting.received != accounting.trained + accounting.duplicate
        {
            return Err(ExitError::new(
                ExitCode::Failure,
                format!("iteration {iteration} does not add up: {accounting:?}, planned {planned}"),
            ));
        }
        Ok(())
    }

    fn collect_pieces(&mut self) -> Result<(), ExitError> {
        while let Some(piece) = self.pieces.try_receive()? {
            match self.assembly.add(piece.header(), piece.payload()) {
                Ok(Some(snapshot)) => self.committer.commit(snapshot),
                Ok(None) => {}
                Err(reason) => tracing::warn!(reason, "a snapshot was cut short"),
            }
        }
        match self.committer.failure() {
            None => Ok(()),
            Some(error) => Err(ExitError::new(
                ExitCode::RunDirectory,
                format!("checkpoint not committed: {error}"),
            )),
        }
    }

    /// Reaps the dead, opens their shards again and starts successors.
    fn bury(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        for death in supervisor.reap() {
            self.channels.clean_up_after_the_dead();
            match death {
                Death::Learner(status) => {
                    let log = self.spec.run_dir.logs().join("learner.log");
                    // Its last words may still be on the way.
                    self.hear_learner(supervisor, reporter)?;
                    return Err(ExitError::new(
                        ExitCode::Child,
                        format!(
                            "the learner died ({}); the end of {}:\n{}\n`octopus resume {}` goes \
                             on from the last checkpoint",
                            describe(status),
                            log.display(),
                            log_tail(&log, 5),
                            self.spec.run_dir.path().display(),
                        ),
                    ));
                }
                Death::Worker(worker, status) => {
                    self.heard.remove(&worker);
                    self.early.retain(|(early, _)| *early != worker);
                    let undelivered = self
                        .scheduler
                        .as_mut()
                        .map_or_else(Vec::new, |scheduler| scheduler.worker_gone(worker));
                    // The worker was busy with the oldest; the others it had not begun.
                    if let Some((iteration, _)) = undelivered.first() {
                        *self.lost.entry(*iteration).or_default() += self.steps_per_block;
                    }
                    reporter.note(&format!(
                        "worker {worker} died ({}); {} open shards are ordered again",
                        describe(status),
                        undelivered.len()
                    ));
                }
            }
        }
        for worker in supervisor.replace_the_dead()? {
            reporter.note(&format!("worker {worker} has been replaced"));
        }
        Ok(())
    }

    fn send_orders(&mut self) -> Result<(), ExitError> {
        let Some(scheduler) = &mut self.scheduler else { return Ok(()) };
        let now = Instant::now();
        let deadline = Duration::from_secs_f64(self.spec.config.run.order_deadline_s);
        let repeated = scheduler.repeat_overdue(now, deadline);
        if !repeated.is_empty() {
            tracing::warn!(orders = repeated.len(), "orders are overdue and sent again");
        }
        for order in scheduler.assign(now).iter().chain(&repeated) {
            self.orders.send(order)?;
        }
        Ok(())
    }

    /// Kills workers that have not been heard for too long.
    fn check_deadlines(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let deadline = Duration::from_secs_f64(self.spec.config.run.order_deadline_s);
        let silent: Vec<_> = self
            .heard
            .iter()
            .filter(|(_, heard)| heard.elapsed() > deadline)
            .map(|(&worker, _)| worker)
            .collect();
        for worker in silent {
            reporter.note(&format!(
                "worker {worker} has been silent for {} s and is replaced",
                deadline.as_secs_f64()
            ));
            self.heard.remove(&worker);
            supervisor.kill_worker(worker);
        }
        if self.scheduler.is_none() && self.started.elapsed() > START_DEADLINE {
            let log = self.spec.run_dir.logs().join("learner.log");
            return Err(ExitError::new(
                ExitCode::Child,
                format!(
                    "the learner was not ready after {} s; the end of {}:\n{}",
                    START_DEADLINE.as_secs(),
                    log.display(),
                    log_tail(&log, 5)
                ),
            ));
        }
        Ok(())
    }

    /// Begins the end if it is time.
    fn check_stop(&mut self, reporter: &mut Reporter) {
        if self.stopped_by.is_some() {
            return;
        }
        let limit = self.spec.config.run.time_limit();
        let reason = if self.spec.stop.count() > 0 {
            reporter.note("stopping after this iteration; Ctrl-C again stops at once");
            StoppedBy::Signal
        } else if limit.is_some_and(|limit| self.started.elapsed() >= limit) {
            reporter.note("time limit reached, stopping after this iteration");
            StoppedBy::TimeLimit
        } else {
            return;
        };
        self.stopped_by = Some(reason);
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.stop_after_current();
        }
    }

    /// Has the final state committed and everybody sent home.
    fn finish(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<Outcome, ExitError> {
        let deadline = Instant::now() + FINISH_DEADLINE;
        self.orders.send(&Order::Snapshot)?;
        let checkpoint = loop {
            self.bell.wait(TICK);
            self.tick(supervisor, reporter)?;
            if let Some((iteration, path)) = self.committer.newest()
                && iteration == self.reported
            {
                break path;
            }
            if Instant::now() > deadline {
                return Err(ExitError::new(
                    ExitCode::Child,
                    format!("no final checkpoint after {} s", FINISH_DEADLINE.as_secs()),
                ));
            }
        };
        self.orders.send(&Order::Stop)?;
        supervisor.wait_for_all(EXIT_DEADLINE);
        Ok(Outcome {
            iterations: self.reported,
            env_steps: self.reported * self.spec.config.steps_per_iteration(),
            stopped_by: self.stopped_by.unwrap_or(StoppedBy::Budget),
            checkpoint,
        })
    }
}
