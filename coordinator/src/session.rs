//! The loop of a run: orders out, progress in, the dead replaced, snapshots committed.
//!
//! One thread owns all ports and children (iceoryx2's ports are single-threaded, and children die
//! with the thread that started them). It sleeps until the bell rings or a tick is over, then
//! looks at everything: status, progress, snapshot pieces, deaths, deadlines, stop requests. All
//! decisions about shards are the [`Scheduler`]'s, all handling of processes the [`Supervisor`]'s;
//! commits are written by a [`Committer`] thread, so the loop never waits for a disk.
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
use proto::{Digest, ExitCode, ExitError};
use sim_worker::robot::Robot;
use tokio::sync::oneshot;

use self::books::Books;
use self::failures::Failures;
use self::monitor::Monitor;
use crate::checkpoint::{Assembly, Checkpoint, CheckpointError, CheckpointStore, Name, Snapshot};
use crate::committer::{Committed, Committer};
use crate::live::{Command, LiveRun, LiveStatus};
use crate::preflight;
use crate::report::{Live, Reporter};
use crate::scheduler::Scheduler;
use crate::selection::{Selection, Verdict};
use crate::signals::StopRequests;
use crate::supervisor::{Cause, Death, Programs, Supervisor, log_tail};

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
/// How long a learner or worker may take to come up.
const START_DEADLINE: Duration = Duration::from_mins(2);
/// How long the last snapshot may take, from the request to the committed checkpoint.
const FINISH_DEADLINE: Duration = Duration::from_mins(5);
/// How long children may take to exit after [`Order::Stop`].
const EXIT_DEADLINE: Duration = Duration::from_secs(5);
/// Crashes of the learner in a row, without a new iteration in between, that end the run.
const MAX_LEARNER_CRASHES: u32 = 3;
/// The same for deaths by a signal from outside.
const MAX_LEARNER_KILLS: u32 = 50;

/// Runs until the budget, the time limit, a signal or an error ends it. Whatever happens, no
/// process and no shared memory is left when this returns.
pub fn run(spec: &SessionSpec, reporter: &mut Reporter) -> Result<Outcome, ExitError> {
    let mut supervisor = Supervisor::new(
        spec.programs.clone(),
        spec.run_dir.clone(),
        spec.domain.clone(),
        &spec.config.run,
    )?;
    let result = Session::start(spec, &mut supervisor)
        .and_then(|mut session| session.run(&mut supervisor, reporter));
    spec.live.close();
    supervisor.close();
    result
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
    assembly: Assembly,
    committer: Committer,
    selection: Selection,
    failures: Failures,
    books: Books,
    monitor: Monitor,
    /// Present while the learner is ready.
    scheduler: Option<Scheduler>,
    /// When each worker was last heard.
    heard: BTreeMap<WorkerId, Instant>,
    /// When the learner was last heard, or was started.
    learner_heard: Instant,
    /// Workers that are ready before the learner is.
    early: Vec<(WorkerId, u32)>,
    /// Where the learner was started from, in iterations.
    origin: u64,
    /// Iterations reported.
    reported: u64,
    /// Digests of iterations that were trained on before and are trained on again.
    promised: BTreeMap<u64, Digest>,
    /// Iterations of the newest committed checkpoint, and its directory.
    committed: Option<(u64, PathBuf)>,
    committed_at: Instant,
    /// A checkpoint is wanted of the state after at least so many iterations.
    asked: Option<u64>,
    /// Who wants to know of it.
    askers: Vec<(u64, oneshot::Sender<Result<String, String>>)>,
    /// Deaths of the learner in a row, without a new iteration in between.
    learner_failures: u32,
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
    fn start(spec: &'a SessionSpec, supervisor: &mut Supervisor) -> Result<Self, ExitError> {
        let config = &spec.config;
        let dimensions = Dimensions::new(config, spec.robot.n_arms);
        let sizes = ChannelSizes::new(config, &dimensions);
        let channels = Channels::create(&spec.domain, sizes)?;
        let store = CheckpointStore::new(spec.run_dir.checkpoints());
        let best = store.best().ok().flatten();
        let best = best
            .and_then(|entry| Some((entry.name.to_string(), entry.labels.score.as_ref()?.value)));
        let mut monitor = Monitor::new();
        monitor.best.clone_from(&best);
        let now = Instant::now();
        let mut session = Self {
            bell: channels.listener(Role::Coordinator)?,
            orders: channels.order_sender()?,
            progress: channels.progress_receiver()?,
            status: channels.status_receiver()?,
            pieces: channels.snapshot_receiver()?,
            assembly: Assembly::new(),
            committer: Committer::start(
                store.clone(),
                config.clone(),
                spec.robot.to_toml(),
                spec.provenance.clone(),
            ),
            selection: Selection::new(config, best.map(|(_, score)| score)),
            failures: Failures::new(
                &spec.run_dir,
                config,
                &dimensions,
                channels.policy_receiver()?,
            ),
            books: Books::default(),
            monitor,
            store,
            channels,
            scheduler: None,
            heard: BTreeMap::new(),
            learner_heard: now,
            early: Vec::new(),
            origin: 0,
            reported: 0,
            promised: BTreeMap::new(),
            committed: None,
            committed_at: now,
            asked: None,
            askers: Vec::new(),
            learner_failures: 0,
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
        self.committed = from.map(|checkpoint| (self.origin, checkpoint.dir.clone()));
        self.learner_heard = Instant::now();
        supervisor.start_learner(from.map(Checkpoint::state).as_deref())?;
        supervisor.scale(self.workers)?;
        Ok(())
    }

    fn run(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<Outcome, ExitError> {
        self.promised = reporter.take_promised();
        loop {
            self.bell.wait(TICK);
            self.tick(supervisor, reporter)?;
            self.check_stop(reporter);
            if self.scheduler.as_ref().is_some_and(Scheduler::is_finished)
                && let Some(checkpoint) = self.finish()?
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
        self.collect_pieces()?;
        self.hear_committer(reporter)?;
        self.bury(supervisor, reporter)?;
        self.obey(supervisor, reporter)?;
        self.send_orders()?;
        self.check_deadlines(supervisor, reporter)?;
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
                    if let Some(verdict) = self.selection.played(chunk, errors) {
                        self.judge(verdict);
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
                    self.learner_ready(iteration, now)?;
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

    fn learner_ready(&mut self, iteration: u64, now: Instant) -> Result<(), ExitError> {
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
        if let Some(before) = self.promised.remove(&iteration)
            && before != report.digest
        {
            return Err(ExitError::new(
                ExitCode::Failure,
                format!(
                    "iteration {iteration} was trained on again and ended with digest {}, before \
                     it was {before}: this machine, or this build, is not the one of before",
                    report.digest
                ),
            ));
        }
        let elapsed = self.last_report.elapsed().as_secs_f64();
        self.last_report = Instant::now();
        let live = Live {
            wall_s: self.started.elapsed().as_secs_f64(),
            env_steps_per_s: report.accounting.trained as f64 / elapsed,
            workers: self.workers,
            restarts: supervisor.restarts() + self.learner_restarts,
        };
        let line = reporter.iteration(&report, &live).map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be written: {error:#}"))
        })?;
        self.monitor.iteration(&report);
        self.monitor.env_steps_per_s = live.env_steps_per_s;
        self.monitor.last = line;
        self.reported = iteration + 1;
        self.learner_failures = 0;
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.iteration_done(iteration);
        }
        let every = self.spec.config.run.checkpoint_every_s;
        if every > 0.0 && self.asked.is_none() && self.committed_at.elapsed().as_secs_f64() > every
        {
            self.ask()?;
        }
        Ok(())
    }

    /// Asks the learner for a snapshot that will be committed.
    fn ask(&mut self) -> Result<(), ExitError> {
        self.asked = Some(self.reported);
        Ok(self.orders.send(&Order::Snapshot)?)
    }

    fn collect_pieces(&mut self) -> Result<(), ExitError> {
        while let Some(piece) = self.pieces.try_receive()? {
            match self.assembly.add(piece.header(), piece.payload()) {
                Ok(Some(snapshot)) => self.snapshot_arrived(snapshot),
                Ok(None) => {}
                Err(reason) => tracing::warn!(reason, "a snapshot was cut short"),
            }
        }
        Ok(())
    }

    /// Commits a snapshot, has its policy evaluated, or both.
    fn snapshot_arrived(&mut self, snapshot: Snapshot) {
        let run = &self.spec.config.run;
        let iteration = snapshot.iteration;
        let asked = self.asked.is_some_and(|asked| iteration >= asked);
        if asked {
            self.asked = None;
        }
        let env_steps = iteration * self.spec.config.steps_per_iteration();
        // A policy that nobody would call the best is not worth an evaluation.
        let last = self.finishing.is_some() && self.stopped_by != Some(StoppedBy::Signal);
        let evaluates = run.evaluate_every > 0
            && (run.plans_evaluation(iteration) || last)
            && env_steps >= run.best_after;
        let commits = asked || run.plans_checkpoint(iteration);
        let candidate = if commits {
            self.committer.commit(snapshot);
            None
        } else {
            Some(snapshot)
        };
        if !evaluates {
            return;
        }
        let Some(scheduler) = &mut self.scheduler else { return };
        for chunk in self.selection.open() {
            scheduler.evaluation_done(chunk, Instant::now());
        }
        scheduler.evaluate(self.selection.begin(iteration, candidate));
    }

    /// Keeps what is the best so far.
    fn judge(&mut self, verdict: Verdict) {
        let Verdict { iteration, score, candidate, improved } = verdict;
        let is_candidate = candidate.is_some();
        if improved && let Some(snapshot) = candidate {
            self.committer.commit(snapshot);
        }
        if improved || !is_candidate {
            self.committer.score(iteration, score);
        }
    }

    fn hear_committer(&mut self, reporter: &mut Reporter) -> Result<(), ExitError> {
        for result in self.committer.results() {
            match result {
                Committed::Checkpoint { iteration, dir, elapsed } => {
                    self.monitor.commits += 1;
                    self.monitor.stages.commit_s += elapsed.as_secs_f64();
                    let name = Name::of_iteration(iteration).to_string();
                    tracing::info!(name, seconds = elapsed.as_secs_f64(), "checkpoint committed");
                    self.monitor.checkpoint = Some(name.clone());
                    self.committed_at = Instant::now();
                    if self.committed.as_ref().is_none_or(|(newest, _)| iteration >= *newest) {
                        self.committed = Some((iteration, dir));
                    }
                    let (done, waiting) =
                        self.askers.drain(..).partition(|(asked, _)| iteration >= *asked);
                    self.askers = waiting;
                    let done: Vec<(u64, oneshot::Sender<_>)> = done;
                    for (_, asker) in done {
                        let _ = asker.send(Ok(name.clone()));
                    }
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
                    for (_, asker) in self.askers.drain(..) {
                        let _ = asker.send(Err(message.clone()));
                    }
                    if self.finishing.is_some() && iteration == self.reported {
                        return Err(ExitError::new(ExitCode::RunDirectory, message));
                    }
                    // What was committed before is whole, and there may be room again next time.
                    reporter.note(&format!("WARNING: {message}; the training goes on without it"));
                }
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
        for death in supervisor.reap() {
            self.channels.clean_up_after_the_dead();
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
                    supervisor.check_failures(worker, cause)?;
                }
            }
        }
        for worker in supervisor.replace_the_dead()? {
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
        self.learner_failures += 1;
        let killed = matches!(cause, Cause::Killed(_));
        let most = if killed { MAX_LEARNER_KILLS } else { MAX_LEARNER_CRASHES };
        if self.learner_failures >= most || (self.scheduler.is_none() && !killed) {
            let log = self.spec.run_dir.logs().join("learner.log");
            return Err(ExitError::new(
                ExitCode::Child,
                format!(
                    "the learner died ({cause}); the end of {}:\n{}\n`octopus resume {}` goes on \
                     from the last checkpoint",
                    log.display(),
                    log_tail(&log, 5),
                    self.spec.run_dir.path().display(),
                ),
            ));
        }
        // Workers hold orders and policies of the future that is now undone.
        supervisor.kill_all();
        self.committer.settle();
        self.hear_committer(reporter)?;
        while self.status.try_receive()?.is_some() {}
        while self.progress.try_receive()?.is_some() {}
        while self.pieces.try_receive()?.is_some() {}
        self.failures.take_policies()?;
        self.failures.forget_policies();
        self.channels.clean_up_after_the_dead();
        self.assembly = Assembly::new();
        self.selection.abandon();
        let received = self.scheduler.take().map_or(0, |scheduler| scheduler.received());
        self.books.all_lost(received as u64 * self.steps_per_block);
        self.early.clear();
        self.heard.clear();
        self.asked = None;
        self.finishing = None;

        let from = match self.store.latest() {
            Ok(checkpoint) => Some(checkpoint),
            Err(CheckpointError::NotFound { .. }) => None,
            Err(error) => return Err(ExitError::new(ExitCode::RunDirectory, error.to_string())),
        };
        let iteration = from.as_ref().map_or(0, |checkpoint| checkpoint.manifest.iteration);
        reporter.note(&format!(
            "the learner died ({cause}); going on from iteration {iteration} of {}",
            self.reported
        ));
        self.promised.extend(reporter.rewind(iteration).map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be rewound: {error:#}"))
        })?);
        self.learner_restarts += 1;
        if !self.askers.is_empty() {
            self.asked = Some(iteration);
        }
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
                            reporter
                                .note(&format!("{workers} workers from now on, before {before}"));
                            Ok(before)
                        }
                        Err(reason) => Err(reason),
                    };
                    // Who asked may have gone.
                    let _ = reply.send(answer);
                }
                Command::Checkpoint { reply } => match &self.committed {
                    // Nothing was trained since, and nothing is being trained now.
                    Some((iteration, _))
                        if *iteration == self.reported && self.finishing.is_some() =>
                    {
                        let _ = reply.send(Ok(Name::of_iteration(*iteration).to_string()));
                    }
                    _ => {
                        self.askers.push((self.reported, reply));
                        self.ask()?;
                    }
                },
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
        let seconds = deadline.as_secs_f64();
        for worker in silent {
            reporter
                .note(&format!("worker {worker} has been silent for {seconds} s and is replaced"));
            self.heard.remove(&worker);
            supervisor.kill_worker(worker);
        }
        if self.scheduler.is_some() && self.learner_heard.elapsed() > deadline {
            reporter.note(&format!("the learner has been silent for {seconds} s and is replaced"));
            self.learner_heard = Instant::now();
            supervisor.kill_learner();
        }
        if self.scheduler.is_none() && self.learner_heard.elapsed() > START_DEADLINE {
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

    /// Has the final state committed and evaluated; returns its directory once that is done.
    fn finish(&mut self) -> Result<Option<PathBuf>, ExitError> {
        let Some(deadline) = self.finishing else {
            self.finishing = Some(Instant::now() + FINISH_DEADLINE);
            self.ask()?;
            return Ok(None);
        };
        if self.asked.is_none()
            && self.selection.is_idle()
            && let Some((iteration, path)) = &self.committed
            && *iteration == self.reported
        {
            self.committer.settle();
            return Ok(Some(path.clone()));
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
            best: self.monitor.best.clone(),
            last: self.monitor.last.clone(),
        }
    }
}
