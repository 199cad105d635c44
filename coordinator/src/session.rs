//! The loop of a run: orders out, progress in, the dead replaced, snapshots committed.
//!
//! One thread owns all ports and children (iceoryx2's ports are single-threaded, and children die
//! with the thread that started them). It sleeps until the bell rings or a tick is over, then
//! looks at everything: status, progress, snapshot pieces, deaths, deadlines, stop requests. All
//! decisions about shards are the [`Scheduler`]'s, all handling of processes the [`Supervisor`]'s;
//! commits are written by a [committer](crate::committer) thread, so the loop never waits for a disk.
//!
//! What can happen to a process, and what becomes of it:
//!
//! * A worker dies: its shards are open again, a successor starts after a back-off.
//! * A worker or the learner is silent for too long: it is killed, and so has died.
//! * The learner dies: everything since the last checkpoint is gone with it. All children are
//!   started anew from that checkpoint, the metrics are wound back, and every iteration that is
//!   trained on again must end with the digest that it had.
//! * A block cannot be made: see [`failures`].

pub mod failures;

mod books;
mod monitor;
mod snapshots;

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

use self::books::Books;
use self::failures::Failures;
use self::monitor::Monitor;
use self::snapshots::{Evaluation, Phase, Snapshots};
use crate::checkpoint::{Checkpoint, CheckpointError, CheckpointStore, Name};
use crate::committer::Committed;
use crate::live::{Best, Command, LiveRun, LiveStatus};
use crate::preflight;
use crate::report::{Live, Reporter};
use crate::scheduler::Scheduler;
use crate::signals::StopRequests;
use crate::supervisor::{Cause, Death, Deaths, Programs, Supervisor, log_tail};

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
    /// Ends after this many iterations, without changing the budget that schedules run over.
    pub until: Option<u64>,
    /// Where others see what the run is doing, and ask it for something.
    pub live: LiveRun,
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
/// How long a learner or worker may take at least until it is ready, however short the deadline is
/// for one that has been heard.
const START_DEADLINE: Duration = Duration::from_secs(10);
/// How long the last snapshot may take, from the request to the committed checkpoint.
const FINISH_DEADLINE: Duration = Duration::from_mins(5);
/// How long children may take to exit after [`Order::Stop`].
const EXIT_DEADLINE: Duration = Duration::from_secs(5);
/// Deaths of the learner in a row, without a new iteration in between, that end the run.
const MAX_LEARNER_CRASHES: u32 = 3;
/// The same for deaths by a signal from outside.
const MAX_LEARNER_KILLS: u32 = 50;

/// Runs until the budget, the time limit, a signal or an error ends it. Whatever happens, no
/// process and no shared memory is left when this returns.
pub fn run(spec: &SessionSpec, reporter: &mut Reporter) -> Result<Outcome, ExitError> {
    let dimensions = Dimensions::new(&spec.config, spec.robot.n_arms);
    let sizes = ChannelSizes::new(&spec.config, &dimensions);
    let mut supervisor = Supervisor::new(
        spec.programs.clone(),
        spec.run_dir.clone(),
        spec.domain.clone(),
        &spec.config.run,
        sizes.max_workers,
    )?;
    let result = Session::start(spec, &dimensions, sizes, &mut supervisor)
        .and_then(|mut session| session.run(&mut supervisor, reporter));
    spec.live.close();
    supervisor.close();
    result
}

/// What metrics say of a run cannot be kept.
fn unwritten(error: &anyhow::Error) -> ExitError {
    ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be written: {error:#}"))
}

/// The state of a run's loop.
struct Session<'a> {
    spec: &'a SessionSpec,
    store: CheckpointStore,
    channels: Channels,
    bell: BellListener,
    orders: MessageSender<Order>,
    progress: MessageReceiver<Progress>,
    status: MessageReceiver<Status>,
    pieces: PieceReceiver,
    snapshots: Snapshots,
    failures: Failures,
    books: Books,
    monitor: Monitor,
    /// Present while the learner is ready.
    scheduler: Option<Scheduler>,
    /// When each worker was last heard.
    heard: BTreeMap<WorkerId, Instant>,
    /// When the learner was last heard, or was started.
    learner_heard: Instant,
    /// What the learner chose for its products: one that takes its place must not choose otherwise.
    precision: Option<String>,
    /// Workers that are ready before the learner is.
    early: Vec<(WorkerId, u32)>,
    /// Where the learner was started from, in iterations.
    origin: u64,
    /// Iterations reported.
    reported: u64,
    learner_deaths: Deaths,
    learner_restarts: u64,
    workers: usize,
    steps_per_block: u64,
    started: Instant,
    last_report: Instant,
    stopped_by: Option<StoppedBy>,
    /// Until when the last checkpoint must be there, once everything is trained.
    finishing: Option<Instant>,
}

impl<'a> Session<'a> {
    fn start(
        spec: &'a SessionSpec,
        dimensions: &Dimensions,
        sizes: ChannelSizes,
        supervisor: &mut Supervisor,
    ) -> Result<Self, ExitError> {
        let config = &spec.config;
        let channels = Channels::create(&spec.domain, sizes)?;
        let store = CheckpointStore::new(spec.run_dir.checkpoints());
        let best = store.best().ok().flatten();
        let mut monitor = Monitor::new();
        monitor.best = best
            .and_then(|entry| Some((entry.name.to_string(), entry.labels.score.as_ref()?.value)));
        let now = Instant::now();
        let mut session = Self {
            bell: channels.listener(Role::Coordinator)?,
            orders: channels.order_sender()?,
            progress: channels.progress_receiver()?,
            status: channels.status_receiver()?,
            pieces: channels.snapshot_receiver()?,
            snapshots: Snapshots::new(
                config,
                spec.robot.to_toml(),
                spec.provenance.clone(),
                store.clone(),
            ),
            failures: Failures::new(&spec.run_dir, config, dimensions, channels.policy_receiver()?),
            books: Books::default(),
            monitor,
            store,
            channels,
            scheduler: None,
            heard: BTreeMap::new(),
            learner_heard: now,
            precision: None,
            early: Vec::new(),
            origin: 0,
            reported: 0,
            learner_deaths: Deaths::default(),
            learner_restarts: 0,
            workers: config.run.workers,
            steps_per_block: (dimensions.n_envs * dimensions.n_steps) as u64,
            started: now,
            last_report: now,
            stopped_by: None,
            finishing: None,
            spec,
        };
        session.start_children(spec.resume.as_ref(), supervisor)?;
        Ok(session)
    }

    /// Starts the learner where `from` ends, and all workers.
    fn start_children(
        &mut self,
        from: Option<&Checkpoint>,
        supervisor: &mut Supervisor,
    ) -> Result<(), ExitError> {
        self.origin = from.map_or(0, |checkpoint| checkpoint.manifest.iteration);
        self.reported = self.origin;
        self.snapshots.begin_from(from.map(|checkpoint| (self.origin, checkpoint.dir.clone())));
        self.learner_heard = Instant::now();
        let state = from.map(Checkpoint::state);
        supervisor.start_learner(state.as_deref(), self.precision.as_deref())?;
        supervisor.scale(self.workers)?;
        Ok(())
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
            if self.scheduler.as_ref().is_some_and(Scheduler::is_finished)
                && let Some(checkpoint) = self.finish(reporter)?
            {
                self.orders.send(&Order::Stop)?;
                supervisor.wait_for_all(EXIT_DEADLINE);
                return Ok(Outcome {
                    iterations: self.reported,
                    env_steps: self.reported * self.spec.config.steps_per_iteration(),
                    stopped_by: self.stopped_by.unwrap_or(StoppedBy::Budget),
                    checkpoint,
                });
            }
        }
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
        self.failures.take_policies()?;
        // Before the deaths: what a process said before it died still counts.
        self.hear_workers(supervisor, reporter)?;
        self.hear_learner(supervisor, reporter)?;
        self.collect_pieces(supervisor, reporter)?;
        self.hear_committer(reporter)?;
        self.bury(supervisor, reporter)?;
        self.obey(supervisor, reporter)?;
        self.send_orders()?;
        self.check_deadlines(supervisor, reporter);
        if self.monitor.is_due() {
            self.spec.live.publish(self.look(supervisor));
        }
        Ok(())
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
                    if supervisor.is_leaving(worker, incarnation) {
                        self.orders.send(&Order::Leave { worker, incarnation })?;
                    }
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
                Status::BlockDone {
                    worker, incarnation, iteration, env_steps, rollout_ns, ..
                } => {
                    self.books.produced(iteration, env_steps);
                    self.monitor.block(worker, env_steps, rollout_ns);
                    if supervisor.is_current(worker, incarnation) {
                        self.heard.insert(worker, now);
                        supervisor.worker_delivered(worker);
                    }
                }
                Status::EvaluationDone { chunk, errors, .. } => {
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.evaluation_done(chunk, now);
                    }
                    if let Some(evaluated) = self.snapshots.played(chunk, errors) {
                        let wall_s = self.started.elapsed().as_secs_f64();
                        reporter
                            .evaluation(&evaluated, wall_s)
                            .map_err(|error| unwritten(&error))?;
                    }
                }
                Status::Failed { worker, incarnation, message, fault } => {
                    reporter.note(&format!("worker {worker}: {message}"));
                    let Some(fault) = fault else { continue };
                    let address = (fault.iteration, fault.shard);
                    if supervisor.is_current(worker, incarnation)
                        && let Some(scheduler) = &mut self.scheduler
                    {
                        scheduler.give_back(worker, address, now);
                        self.failures.failed(address, &message, Some(&fault))?;
                    }
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
            self.learner_heard = now;
            match progress {
                Progress::Ready { iteration, digest, precision, .. } => {
                    tracing::info!(iteration, %digest, precision, "learner is ready");
                    self.precision = Some(precision);
                    self.learner_ready(iteration, now, reporter)?;
                }
                Progress::Heartbeat => {}
                Progress::BlockReceived { iteration, shard, .. } => {
                    self.failures.made((iteration, shard));
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

    fn learner_ready(
        &mut self,
        iteration: u64,
        now: Instant,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let expected = self.origin;
        if iteration != expected {
            return Err(ExitError::new(
                ExitCode::Child,
                format!("the learner starts at iteration {iteration} instead of {expected}"),
            ));
        }
        let config = &self.spec.config;
        let planned = config.planned_iterations();
        let end = self.spec.until.map_or(planned, |until| planned.min(until));
        let mut scheduler = Scheduler::new(
            config.env.n_shards as u32,
            config.run.overlap,
            iteration,
            end.max(iteration),
        );
        for (worker, incarnation) in self.early.drain(..) {
            scheduler.worker_ready(worker, incarnation, now);
        }
        if self.stopped_by.is_some() {
            scheduler.stop_after_current();
        }
        if self.learner_restarts > 0 {
            reporter.note(&format!("the learner has been replaced, at iteration {iteration}"));
        }
        self.scheduler = Some(scheduler);
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
        self.books.close(&mut report, self.spec.config.steps_per_iteration())?;
        reporter.check_promised(iteration, report.digest)?;
        let elapsed = self.last_report.elapsed().as_secs_f64();
        self.last_report = Instant::now();
        let live = Live {
            wall_s: self.started.elapsed().as_secs_f64(),
            env_steps_per_s: report.accounting.trained as f64 / elapsed,
            workers: self.workers,
            restarts: supervisor.restarts() + self.learner_restarts,
        };
        let line = reporter.iteration(&report, &live).map_err(|error| unwritten(&error))?;
        self.monitor.iteration(&report);
        self.monitor.env_steps_per_s = live.env_steps_per_s;
        self.monitor.last = line;
        self.reported = iteration + 1;
        self.learner_deaths = Deaths::default();
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.iteration_done(iteration);
        }
        self.snapshots.iteration_done(self.reported);
        Ok(())
    }

    fn collect_pieces(
        &mut self,
        supervisor: &Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        while let Some(piece) = self.pieces.try_receive()? {
            let Some(snapshot) = self.snapshots.add(piece.header(), piece.payload()) else {
                continue;
            };
            // No checkpoint without the lines of its iterations: the learner reported them before
            // it sent the snapshot, and they are durable before that is.
            self.hear_learner(supervisor, reporter)?;
            reporter.sync()?;
            let phase = match self.finishing {
                None => Phase::Training,
                Some(_) => {
                    Phase::Finishing { evaluate: self.stopped_by != Some(StoppedBy::Signal) }
                }
            };
            let Evaluation { play, drop } = self.snapshots.arrived(snapshot, phase);
            if let Some(scheduler) = &mut self.scheduler {
                for chunk in drop {
                    scheduler.evaluation_done(chunk, Instant::now());
                }
                scheduler.evaluate(play);
            }
        }
        Ok(())
    }

    fn hear_committer(&mut self, reporter: &mut Reporter) -> Result<(), ExitError> {
        for result in self.snapshots.results() {
            match result {
                Committed::Checkpoint { iteration, elapsed, .. } => {
                    self.monitor.commits += 1;
                    self.monitor.stages.commit_s += elapsed.as_secs_f64();
                    let name = Name::of_iteration(iteration).to_string();
                    tracing::info!(name, seconds = elapsed.as_secs_f64(), "checkpoint committed");
                    self.monitor.checkpoint = Some(name);
                }
                Committed::Score { iteration, value, best } => {
                    tracing::info!(iteration, value, best, "checkpoint scored");
                    if best {
                        let name = Name::of_iteration(iteration).to_string();
                        self.monitor.best = Some((name, value));
                    }
                }
                Committed::Failed { iteration, error } => {
                    let message = format!("checkpoint {iteration} not committed: {error}");
                    if self.finishing.is_some() && iteration == self.reported {
                        return Err(ExitError::new(ExitCode::RunDirectory, message));
                    }
                    // What was committed before is whole, and there may be room again next time.
                    reporter.note(&format!("warning: {message}; the training goes on without it"));
                }
                Committed::ScoreFailed { iteration, error } => reporter.note(&format!(
                    "warning: the score of checkpoint {iteration} was not written: {error}"
                )),
                Committed::GivenUp { iteration } => reporter.note(&format!(
                    "warning: checkpoint {iteration} not committed: the disk was still busy with \
                     the one before when the next one came"
                )),
            }
        }
        Ok(())
    }

    /// Reaps the dead, opens their shards again and starts successors.
    fn bury(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let deaths = supervisor.reap();
        if !deaths.is_empty() {
            // Once for all of them: it waits where one has died in the middle of something.
            self.channels.clean_up_after_the_dead();
        }
        for death in deaths {
            match death {
                Death::Learner(cause) => {
                    // Its last words may still be on the way.
                    self.hear_learner(supervisor, reporter)?;
                    return self.recover(cause, supervisor, reporter);
                }
                Death::Left(worker) => {
                    self.heard.remove(&worker);
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.worker_gone(worker);
                    }
                    reporter.note(&format!("worker {worker} has left"));
                }
                Death::Worker(worker, cause) => {
                    self.heard.remove(&worker);
                    self.early.retain(|(early, _)| *early != worker);
                    let estate = self
                        .scheduler
                        .as_mut()
                        .map(|scheduler| scheduler.worker_gone(worker))
                        .unwrap_or_default();
                    // The worker was busy with the oldest; the others it had not begun.
                    if let Some((iteration, _)) = estate.undelivered.first() {
                        self.books.lost(*iteration, self.steps_per_block);
                    }
                    reporter.note(&format!(
                        "worker {worker} died ({cause}); {} open shards are ordered again",
                        estate.undelivered.len()
                    ));
                    // Who was killed from outside says nothing about the block it was making.
                    if let Some(address) = estate.at_hand
                        && !matches!(cause, Cause::Killed(_))
                    {
                        let message = format!("its worker died ({cause})");
                        self.failures.failed(address, &message, None)?;
                    }
                    supervisor.check_deaths(worker, cause)?;
                }
            }
        }
        for worker in supervisor.start_due()? {
            reporter.note(&format!("worker {worker} has been replaced"));
        }
        Ok(())
    }

    /// Goes on from the last checkpoint after the learner's death.
    fn recover(
        &mut self,
        cause: Cause,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        self.learner_deaths.count(cause);
        // One that cannot even come up will not come up the next time.
        let is_hopeless = self.scheduler.is_none() && matches!(cause, Cause::Crash(_));
        if is_hopeless || self.learner_deaths.are_too_many(MAX_LEARNER_CRASHES, MAX_LEARNER_KILLS) {
            let log = self.spec.run_dir.logs().join("learner.log");
            let cure = if self.store.latest_until(self.reported).is_ok() {
                let run_dir = self.spec.run_dir.path().display();
                format!("\n`octopus resume {run_dir}` goes on from the last checkpoint")
            } else {
                String::new()
            };
            let message = format!(
                "the learner died ({cause}); the end of {}:\n{}{cure}",
                log.display(),
                log_tail(&log, 5)
            );
            return Err(ExitError::new(cause.exit_code(), message));
        }
        // Workers hold orders and policies of the future that is now undone.
        supervisor.kill_all();
        self.snapshots.learner_gone();
        self.hear_committer(reporter)?;
        while self.status.try_receive()?.is_some() {}
        while self.progress.try_receive()?.is_some() {}
        while self.pieces.try_receive()?.is_some() {}
        self.failures.take_policies()?;
        self.failures.forget_policies();
        self.channels.clean_up_after_the_dead();
        let received = self.scheduler.take().map_or(0, |scheduler| scheduler.received());
        self.books.all_lost(received as u64 * self.steps_per_block);
        self.early.clear();
        self.heard.clear();
        self.finishing = None;

        // A newer one is of a future that the metrics have lost, see `octopus resume`.
        let from = match self.store.latest_until(self.reported) {
            Ok(checkpoint) => Some(checkpoint),
            Err(CheckpointError::NotFound { .. }) => None,
            Err(error) => return Err(ExitError::new(ExitCode::RunDirectory, error.to_string())),
        };
        let iteration = from.as_ref().map_or(0, |checkpoint| checkpoint.manifest.iteration);
        reporter.note(&format!(
            "the learner died ({cause}); going on from iteration {iteration} of {}",
            self.reported
        ));
        reporter.rewind(iteration).map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be rewound: {error:#}"))
        })?;
        self.learner_restarts += 1;
        self.snapshots.go_on_from(iteration);
        self.start_children(from.as_ref(), supervisor)
    }

    /// Does what others ask for.
    fn obey(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        while let Some(command) = self.spec.live.next_command() {
            match command {
                Command::Scale { workers, reply } => {
                    let before = self.workers;
                    let answer = match self.may_scale(workers) {
                        Ok(()) => {
                            self.workers = workers;
                            for (worker, incarnation) in supervisor.scale(workers)? {
                                self.heard.remove(&worker);
                                if let Some(scheduler) = &mut self.scheduler {
                                    scheduler.retire(worker);
                                }
                                self.orders.send(&Order::Leave { worker, incarnation })?;
                            }
                            if workers != before {
                                let s = if workers == 1 { "" } else { "s" };
                                reporter.note(&format!(
                                    "{workers} worker{s} from now on, before {before}"
                                ));
                            }
                            Ok(before)
                        }
                        Err(reason) => Err(reason),
                    };
                    // Who asked may have gone.
                    let _ = reply.send(answer);
                }
                Command::Checkpoint { reply } => self.snapshots.ask_for(self.reported, reply),
            }
        }
        Ok(())
    }

    fn may_scale(&self, workers: usize) -> Result<(), String> {
        let most = self.channels.sizes().max_workers;
        if !(1..=most).contains(&workers) {
            return Err(format!(
                "{workers} workers: this run can have 1 to {most}; a run that is started or \
                 resumed with more can have twice as many as that"
            ));
        }
        preflight::scale(self.channels.sizes(), self.workers, workers)
    }

    fn send_orders(&mut self) -> Result<(), ExitError> {
        let Some(scheduler) = &mut self.scheduler else { return Ok(()) };
        if self.snapshots.must_tell_learner() {
            self.orders.send(&Order::Snapshot)?;
        }
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

    /// Kills who has not been heard for too long.
    fn check_deadlines(&mut self, supervisor: &mut Supervisor, reporter: &mut Reporter) {
        let deadline = Duration::from_secs_f64(self.spec.config.run.order_deadline_s);
        let start_deadline = deadline.max(START_DEADLINE);
        // When it was heard last, or started, and how long it may be silent.
        let silent: Vec<_> = supervisor
            .running_since()
            .filter_map(|(worker, started)| {
                let (since, deadline) = match self.heard.get(&worker) {
                    Some(&heard) => (heard, deadline),
                    None => (started, start_deadline),
                };
                (since.elapsed() > deadline).then_some((worker, deadline.as_secs_f64()))
            })
            .collect();
        for (worker, seconds) in silent {
            if supervisor.kill_worker(worker) {
                reporter.note(&format!(
                    "worker {worker} has been silent for {seconds} s and is replaced"
                ));
            }
        }
        let deadline = if self.scheduler.is_some() { deadline } else { start_deadline };
        if self.learner_heard.elapsed() > deadline {
            let seconds = deadline.as_secs_f64();
            reporter.note(&format!("the learner has been silent for {seconds} s and is replaced"));
            self.learner_heard = Instant::now();
            supervisor.kill_learner();
        }
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

    /// Has the final state committed and evaluated; returns its directory once that is done.
    fn finish(&mut self, reporter: &mut Reporter) -> Result<Option<PathBuf>, ExitError> {
        let Some(deadline) = self.finishing else {
            self.finishing = Some(Instant::now() + FINISH_DEADLINE);
            self.snapshots.ask(self.reported);
            return Ok(None);
        };
        if let Some(checkpoint) = self.snapshots.settled_at(self.reported) {
            let checkpoint = checkpoint.to_owned();
            // What came with the last word of the committer.
            self.hear_committer(reporter)?;
            return Ok(Some(checkpoint));
        }
        if Instant::now() > deadline {
            return Err(ExitError::new(
                ExitCode::Child,
                format!("no final checkpoint after {} s", FINISH_DEADLINE.as_secs()),
            ));
        }
        Ok(None)
    }

    /// What the run looks like from outside.
    fn look(&self, supervisor: &Supervisor) -> LiveStatus {
        let config = &self.spec.config;
        let scheduler = self.scheduler.as_ref();
        let state = match (scheduler, self.finishing, self.stopped_by) {
            (None, _, _) if self.learner_restarts > 0 => "recovering",
            (None, _, _) => "starting",
            (_, Some(_), _) => "finishing",
            (_, _, Some(_)) => "stopping",
            _ => "training",
        };
        let processes: Vec<_> = std::iter::once(Monitor::coordinator())
            .chain(supervisor.processes().iter().map(|view| {
                let ready = match view.worker {
                    None => scheduler.is_some(),
                    Some(worker) => self.heard.contains_key(&worker),
                };
                let tasks = view.worker.zip(scheduler);
                let shards = tasks.map(|(worker, scheduler)| {
                    scheduler.tasks(worker).map(ToString::to_string).collect()
                });
                self.monitor.process(view, ready, shards.unwrap_or_default())
            }))
            .collect();
        let planned_iterations = config.planned_iterations();
        let left = planned_iterations.saturating_sub(self.reported);
        let rate = self.monitor.env_steps_per_s;
        LiveStatus {
            run_dir: self.spec.run_dir.path().to_owned(),
            state: state.to_owned(),
            task: config.task.name.as_str().to_owned(),
            iterations: self.reported,
            planned_iterations,
            env_steps: self.reported * config.steps_per_iteration(),
            env_steps_per_s: rate,
            wall_s: self.started.elapsed().as_secs_f64(),
            eta_s: (rate > 0.0).then(|| (left * config.steps_per_iteration()) as f64 / rate),
            workers: self.workers,
            max_workers: self.channels.sizes().max_workers,
            resident_bytes: processes.iter().map(|process| process.resident_bytes).sum(),
            processes,
            shards_open: scheduler.map_or(0, Scheduler::open),
            shards_in_flight: scheduler.map_or(0, Scheduler::in_flight),
            worker_restarts: supervisor.restarts(),
            learner_restarts: self.learner_restarts,
            stages: self.monitor.stages,
            accounting: self.books.totals,
            shared_memory_bytes: monitor::shared_memory(&self.spec.domain),
            commits: self.monitor.commits,
            checkpoint: self.monitor.checkpoint.clone(),
            best: self.monitor.best.clone().map(|(name, score)| Best { name, score }),
            last: self.monitor.last.clone(),
        }
    }
}
