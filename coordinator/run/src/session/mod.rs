//! The loop of a run: orders out, progress in, the dead replaced, snapshots committed.
//!
//! One thread owns all ports and children (iceoryx2's ports are single-threaded, and children die
//! with the thread that started them). It sleeps until the bell rings or a tick is over, then
//! looks at everything: status, progress, snapshot pieces, deaths, deadlines, stop requests. All
//! decisions about shards are the [`Scheduler`]'s, all handling of processes the [`Supervisor`]'s;
//! commits are written by a [committer](crate::committer) thread, so the loop never waits for a disk.
//!
//! What processes say is taken in by `events`, what becomes of the dead stands in `recovery`, of
//! blocks that cannot be made in [`failures`]; others reach a live run through `control`.

pub mod failures;

mod accounting;
mod audit_list;
mod audits;
mod control;
mod events;
mod host_list;
mod hosts;
mod learner_deaths;
mod monitor;
mod order_queue;
mod recovery;
mod reserved_memory;
mod snapshots;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use channels::{
    BellListener, ChannelSizes, Channels, Domain, MessageReceiver, PieceReceiver, Role,
};
use process::originals::Originals;
use proto::config::Config;
use proto::layout::Dimensions;
use proto::message::{Membership, Order, Progress, RunEnd, Status, WorkerId};
use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use service::live::LiveRun;
use simulator::robot::Robot;
use store::checkpoint::{Checkpoint, CheckpointStore, LockTimeout};
use store::run_files;

use self::accounting::StepAccounts;
use self::audit_list::Audits;
use self::failures::Failures;
use self::host_list::Hosts;
use self::learner_deaths::LearnerDeaths;
use self::monitor::Monitor;
use self::order_queue::OrderQueue;
use self::reserved_memory::ReservedMemory;
use self::snapshots::Snapshots;
use crate::deadlines::finish_deadline;
use crate::loop_clock::{LoopClock, STANDSTILL};
use crate::preflight::checkpoint_size;
use crate::report::Reporter;
use crate::scheduler::Scheduler;
use crate::signals::StopRequests;
use crate::supervisor::{GatewaySpec, Programs, Supervisor};

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
    /// Where it is open to other machines, if it is.
    pub gateway: Option<GatewaySpec>,
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
    /// So many iterations are done as this session was to reach; the budget plans more.
    Pause,
}

/// How a run ended.
#[derive(Debug, Clone)]
pub struct RunResult {
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
/// How long a commit waits while somebody else has the lock of the store.
const LOCK_TIME: Duration = Duration::from_mins(1);
/// How long children may take to exit after [`Order::Stop`].
const EXIT_DEADLINE: Duration = Duration::from_secs(5);

/// Runs until the budget, the time limit, a signal or an error ends it. Whatever happens, no
/// process and no shared memory is left when this returns.
pub fn run(spec: &SessionSpec, reporter: &mut Reporter) -> Result<RunResult, ExitError> {
    let dimensions = Dimensions::new(&spec.config, spec.robot.joints);
    let sizes = ChannelSizes::new(&spec.config, &dimensions);
    // What is compared is read after what children are told of: they never get what was not compared.
    let originals = Originals::read(&spec.run_dir)?;
    check_texts(spec)?;
    let mut supervisor = Supervisor::new(
        spec.programs.clone(),
        spec.run_dir.clone(),
        spec.domain.clone(),
        &spec.config.run,
        sizes.max_workers,
        originals,
    )?;
    if let Some(gateway) = &spec.gateway {
        supervisor.open_to_hosts(gateway.clone(), spec.robot.joints);
    }
    let result = Session::start(spec, &dimensions, sizes, &mut supervisor, reporter).and_then(
        |mut session| {
            let result = session.run(&mut supervisor, reporter);
            if result.as_ref().is_err_and(|error| error.code == ExitCode::Interrupted) {
                // Somebody does not want to wait, for a lock or a disk neither.
                session.snapshots.abandon();
            }
            result
        },
    );
    spec.live.close();
    supervisor.close();
    result
}

/// Refuses a run directory in which something else stands by now than this session was made from.
fn check_texts(spec: &SessionSpec) -> Result<(), ExitError> {
    let damaged =
        |error: anyhow::Error| ExitError::new(ExitCode::RunDirectory, format!("{error:#}"));
    let (config, robot) = (
        run_files::read_config(&spec.run_dir).map_err(damaged)?,
        run_files::read_robot(&spec.run_dir).map_err(damaged)?.0,
    );
    let changed = if config != spec.config {
        spec.run_dir.config()
    } else if robot.to_toml() != spec.robot.to_toml() {
        spec.run_dir.robot()
    } else {
        return Ok(());
    };
    let message =
        format!("{}: was changed while the run started; start it again", changed.display());
    Err(ExitError::new(ExitCode::RunDirectory, message))
}

/// The state of a run's loop.
struct Session<'a> {
    spec: &'a SessionSpec,
    store: CheckpointStore,
    channels: Channels,
    headroom: ReservedMemory,
    bell: BellListener,
    orders: OrderQueue,
    progress: MessageReceiver<Progress>,
    status: MessageReceiver<Status>,
    pieces: PieceReceiver,
    attention: LoopClock,
    snapshots: Snapshots,
    failures: Failures,
    books: StepAccounts,
    /// Digests of the blocks that the learner has received and the hosts that made them, by iteration and shard.
    blocks: BTreeMap<u64, BTreeMap<u32, (Digest, Option<Membership>)>>,
    monitor: Monitor,
    /// Present while the learner is ready.
    scheduler: Option<Scheduler>,
    /// When each worker was last heard.
    heard: BTreeMap<WorkerId, Instant>,
    /// Other machines, and their workers.
    hosts: Hosts,
    /// What of theirs is made a second time.
    audits: Audits,
    /// When the learner was last heard, or was started.
    learner_heard: Instant,
    /// Size of its training state, about (bytes).
    state_size: u64,
    /// Workers that are ready before the learner is.
    early: Vec<(WorkerId, u32)>,
    /// Where the learner was started from, in iterations.
    origin: u64,
    /// The checkpoint that it was started from, and the digest that it must find there.
    base: Option<(PathBuf, Digest)>,
    /// Checkpoints that a learner could not start from, and why.
    refused: BTreeMap<PathBuf, String>,
    /// Iterations reported.
    reported: u64,
    learner_deaths: LearnerDeaths,
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
        reporter: &Reporter,
    ) -> Result<Self, ExitError> {
        let config = &spec.config;
        let channels = Channels::create(&spec.domain, sizes)?;
        let stop = spec.stop.clone();
        let store = CheckpointStore::new(spec.run_dir.checkpoints())
            .with_patience(LockTimeout::new(LOCK_TIME).unless(move || stop.count() > 1));
        let best = store.best().ok().flatten();
        let mut monitor = Monitor::new();
        monitor.best = best
            .and_then(|entry| Some((entry.name.to_string(), entry.labels.score.as_ref()?.value)));
        let now = Instant::now();
        let mut session = Self {
            headroom: ReservedMemory::take(&spec.domain),
            bell: channels.listener(Role::Coordinator)?,
            orders: OrderQueue::new(channels.order_sender()?),
            progress: channels.progress_receiver()?,
            status: channels.status_receiver()?,
            pieces: channels.snapshot_receiver()?,
            snapshots: Snapshots::new(
                config,
                spec.robot.to_toml(),
                spec.provenance.clone(),
                store.clone(),
                {
                    let durability = reporter.durability();
                    move || durability.wait()
                },
            ),
            attention: LoopClock::new(now),
            failures: Failures::new(&spec.run_dir, config, dimensions, channels.policy_receiver()?),
            books: StepAccounts::default(),
            blocks: BTreeMap::new(),
            monitor,
            store,
            channels,
            scheduler: None,
            heard: BTreeMap::new(),
            hosts: Hosts::default(),
            audits: Audits::default(),
            learner_heard: now,
            state_size: checkpoint_size(config, dimensions),
            early: Vec::new(),
            origin: 0,
            base: None,
            refused: BTreeMap::new(),
            reported: 0,
            learner_deaths: LearnerDeaths::default(),
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
        self.base = from.map(|checkpoint| (checkpoint.dir.clone(), checkpoint.manifest.digest));
        self.reported = self.origin;
        self.snapshots.begin_from(from.map(|checkpoint| (self.origin, checkpoint.dir.clone())));
        self.learner_heard = Instant::now();
        let state = from.map(Checkpoint::state);
        supervisor.start_learner(state.as_deref())?;
        supervisor.scale(self.workers)?;
        supervisor.start_gateway()
    }

    fn run(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<RunResult, ExitError> {
        loop {
            self.bell.wait(TICK);
            self.look_at_the_clock(supervisor);
            self.tick(supervisor, reporter)?;
            self.check_stop(reporter);
            if self.scheduler.as_ref().is_some_and(Scheduler::is_finished)
                && let Some(checkpoint) = self.finish(reporter)?
            {
                let stopped_by = self.stopped_by.unwrap_or_else(|| self.reason_to_end());
                // A time limit is an end that was asked for; a signal may be a machine's that is wanted for something else.
                let is_short = self.reason_to_end() != StoppedBy::Budget;
                let end = match stopped_by {
                    StoppedBy::Signal if is_short => RunEnd::Stopped,
                    _ => RunEnd::Over,
                };
                self.orders.send(Order::Stop(end))?;
                supervisor.wait_for_all(EXIT_DEADLINE);
                return Ok(RunResult {
                    iterations: self.reported,
                    env_steps: self.reported * self.spec.config.steps_per_iteration(),
                    stopped_by,
                    checkpoint,
                });
            }
        }
    }

    /// Why a session ended that nobody stopped.
    fn reason_to_end(&self) -> StoppedBy {
        if self.reported < self.spec.config.planned_iterations() {
            StoppedBy::Pause
        } else {
            StoppedBy::Budget
        }
    }

    /// Begins a turn. Where it is late, because this process or its disk stood still, nobody was heard
    /// meanwhile, and all deadlines move by as much.
    fn look_at_the_clock(&mut self, supervisor: &mut Supervisor) {
        let late = self.attention.turn(Instant::now());
        if late.is_zero() {
            return;
        }
        if late > STANDSTILL {
            let seconds = late.as_secs();
            tracing::warn!(
                "the coordinator stood still for {seconds} s; deadlines move by as much"
            );
        }
        for heard in self.heard.values_mut() {
            *heard += late;
        }
        self.learner_heard += late;
        self.hosts.postpone(late);
        if let Some(deadline) = &mut self.finishing {
            *deadline += late;
        }
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.postpone_deadlines(late);
        }
        supervisor.postpone_deadlines(late);
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
                "stopped at once; `octopus resume` goes on from the last checkpoint, if there is one",
            ));
        }
        self.failures.take_policies()?;
        // Before the deaths: what a process said before it died still counts.
        self.hear_workers(supervisor, reporter)?;
        self.hear_learner(supervisor, reporter)?;
        self.compare(reporter)?;
        self.leave_resume_point(supervisor, reporter)?;
        self.collect_pieces(supervisor, reporter)?;
        self.hear_committer(reporter)?;
        self.replace_the_dead(supervisor, reporter)?;
        self.do_what_is_asked(supervisor, reporter)?;
        self.send_orders(supervisor)?;
        self.check_deadlines(supervisor, reporter);
        if self.monitor.is_due() {
            self.headroom.keep();
            self.spec.live.publish(self.look(supervisor));
        }
        Ok(())
    }

    fn send_orders(&mut self, supervisor: &Supervisor) -> Result<(), ExitError> {
        let Some(scheduler) = &mut self.scheduler else { return Ok(()) };
        let snapshots = &self.snapshots;
        let missed = self.orders.retry(|order| match order {
            Order::Snapshot => snapshots.is_awaited(),
            Order::Leave { worker, incarnation } => supervisor.is_leaving(*worker, *incarnation),
            // Also what came by a gateway of before.
            Order::Discard { .. } => true,
            order => scheduler.awaits(order),
        })?;
        self.monitor.orders_missed += missed as u64;
        if self.snapshots.must_tell_learner() {
            self.orders.send(Order::Snapshot)?;
        }
        let now = self.attention.now();
        let mut audits = Vec::new();
        let deadline = Duration::from_secs_f64(self.spec.config.run.order_deadline_s);
        let repeated = scheduler.repeat_overdue(now, deadline);
        if !repeated.is_empty() {
            tracing::warn!(orders = repeated.len(), "orders are overdue and sent again");
            self.monitor.orders_overdue += repeated.len() as u64;
        }
        for order in scheduler.assign(now) {
            if let Order::Audit { worker, incarnation, iteration, shard, .. } = order {
                audits.push((worker, incarnation, (iteration, shard)));
            }
            self.orders.send(order)?;
        }
        for order in repeated {
            self.orders.send(order)?;
        }
        for (worker, incarnation, address) in audits {
            self.audit(worker, incarnation, address)?;
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
            reporter.note("stopping after this iteration; Ctrl-C again does not wait for it");
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
            self.finishing = Some(self.attention.now() + finish_deadline(self.state_size));
            self.snapshots.ask(self.reported);
            return Ok(None);
        };
        if let Some(checkpoint) = self.snapshots.settled_at(self.reported) {
            let checkpoint = checkpoint.to_owned();
            // What came with the last word of the committer.
            self.hear_committer(reporter)?;
            return Ok(Some(checkpoint));
        }
        if self.attention.now() <= deadline {
            return Ok(None);
        }
        let waited = finish_deadline(self.state_size).as_secs();
        let Some(checkpoint) = self.snapshots.settled_unevaluated_at(self.reported) else {
            let message = format!("no final checkpoint after {waited} s");
            return Err(ExitError::new(ExitCode::Child, message));
        };
        reporter.note(&format!(
            "warning: the last policy was not evaluated: no worker played any of it for {waited} s; `octopus eval` does"
        ));
        Ok(Some(checkpoint.to_owned()))
    }
}
