//! The worker process: waits for orders, rolls out, sends, and remembers nothing.
//!
//! A worker's only state is what it was sent and can be sent again: orders not yet done, and the
//! newest policy versions. Whatever happens to it, another worker makes the same blocks.
//!
//! The floating-point environment is left as the system sets it: subnormal numbers are computed with,
//! not flushed to zero, so that every processor gives the same bits.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use channels::ChannelError;
use channels::{
    ArrayReceiver, ArraySender, BellListener, ChannelSizes, Channels, Domain, MessageReceiver,
    MessageSender, Role, WHILE_THE_PARENT_LIVES,
};
use proto::config::Config;
use proto::layout::{BlockHeader, PolicyHeader};
use proto::message::{self, EvaluationChunk, Fault, HEARTBEAT, Order, Status, WorkerId};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};

use simulator::env::{EpisodeError, Moment};
use simulator::evaluate;
use simulator::policy::Policy;
use simulator::robot::Robot;
use simulator::rollout::{RolloutError, RolloutSpec, World, rollout};

/// Policy versions that a worker keeps: with overlap it acts with the one before the newest.
const KEPT_POLICIES: usize = 3;
/// Pause before a block is made again that no learner was there to take.
const RETRY: Duration = Duration::from_millis(50);

/// Rolls out policies for a SpaceOctopus run; started by `octopus`, not by hand.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "sim-worker", version)]
pub struct Arguments {
    /// Run directory, holding config.toml and robot.toml.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// Number of this worker.
    #[arg(long, value_name = "N")]
    pub worker: u32,
    /// How often this worker was started before.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub incarnation: u32,
    /// Name under which the run's shared memory lives.
    #[arg(long, value_name = "NAME")]
    pub domain: String,
    /// Process that started this one: the worker does not start if that is gone already.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
    /// Processor to stay on, counted among those that this process may use.
    #[arg(long, value_name = "N")]
    pub pin: Option<usize>,
}

/// Works until it is told to stop.
pub fn run(arguments: &Arguments) -> Result<(), ExitError> {
    process::child::die_with_parent(arguments.parent)?;
    if let Some(index) = arguments.pin {
        process::child::pin(index)?;
    }
    let world = load(&RunDir::new(&arguments.run_dir))?;
    let mut worker = Worker::connect(arguments, &world)?;
    tracing::info!(
        worker = arguments.worker,
        incarnation = arguments.incarnation,
        backend = ?simulator::scalar::Backend::detect(),
        "ready"
    );
    worker.serve()
}

/// Reads configuration and robot of a run.
pub fn load(run_dir: &RunDir) -> Result<World, ExitError> {
    let read = |path: PathBuf| {
        process::input::read_text(&path).map(|text| (text, path.display().to_string())).map_err(
            |error| {
                ExitError::new(
                    ExitCode::RunDirectory,
                    format!("{}: cannot be read: {error}", path.display()),
                )
            },
        )
    };
    let bad = |error: &dyn std::fmt::Display| ExitError::new(ExitCode::BadInput, error.to_string());
    let (text, origin) = read(run_dir.config())?;
    let config = Config::from_resolved_toml(&text, &origin).map_err(|error| bad(&error))?;
    let (text, origin) = read(run_dir.robot())?;
    let robot = Robot::from_toml(&text, Path::new(&origin)).map_err(|error| bad(&error))?;
    Ok(World::new(&config, &robot))
}

/// One block to be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Block {
    iteration: u64,
    policy_version: u64,
    shard: u32,
}

/// What there is to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Job {
    Rollout(Block),
    Evaluation(EvaluationChunk),
}

impl Job {
    fn policy_version(&self) -> u64 {
        match self {
            Self::Rollout(block) => block.policy_version,
            Self::Evaluation(chunk) => chunk.policy_version,
        }
    }
}

/// What became of a job.
enum Outcome {
    Done,
    /// Nobody was there to take the block: make it again later.
    Unclaimed,
}

struct Worker<'a> {
    world: &'a World,
    id: WorkerId,
    incarnation: u32,
    jobs: VecDeque<Job>,
    stopping: bool,
    /// Oldest first.
    policies: VecDeque<(u64, Policy)>,
    heartbeat: Instant,
    status: MessageSender<Status>,
    orders: MessageReceiver<Order>,
    policy: ArrayReceiver<PolicyHeader>,
    blocks: ArraySender<BlockHeader>,
    bell: BellListener,
    // Dropped last: ports must not outlive their services.
    _channels: Channels,
}

impl<'a> Worker<'a> {
    fn connect(arguments: &Arguments, world: &'a World) -> Result<Self, ExitError> {
        let connect = || -> Result<Self, ChannelError> {
            let domain = Domain::parse(&arguments.domain)?;
            let sizes = ChannelSizes::new(&world.config, &world.dimensions);
            let channels = Channels::open(&domain, sizes)?;
            Ok(Self {
                world,
                id: arguments.worker,
                incarnation: arguments.incarnation,
                jobs: VecDeque::new(),
                stopping: false,
                policies: VecDeque::new(),
                heartbeat: Instant::now(),
                status: channels.status_sender()?,
                // Heard before anything is looked for, so that no ring is missed.
                bell: channels.listener(Role::Workers)?,
                orders: channels.order_receiver()?,
                policy: channels.policy_receiver()?,
                blocks: channels.block_sender(WHILE_THE_PARENT_LIVES)?,
                _channels: channels,
            })
        };
        connect().map_err(|error| ExitError::new(ExitCode::Environment, error.to_string()))
    }

    fn serve(&mut self) -> Result<(), ExitError> {
        let (worker, incarnation) = (self.id, self.incarnation);
        self.send(&Status::Ready { worker, incarnation, orders: self.orders.port() })?;
        loop {
            self.take_orders()?;
            self.take_policies()?;
            // "Finish what is at hand": the block being made was finished before this line.
            if self.stopping {
                return Ok(());
            }
            match self.next_job() {
                Some(Job::Rollout(block)) => match self.make(block)? {
                    Outcome::Done => {}
                    Outcome::Unclaimed => {
                        self.jobs.push_back(Job::Rollout(block));
                        self.bell.wait(RETRY);
                    }
                },
                Some(Job::Evaluation(chunk)) => self.evaluate(chunk)?,
                None => self.bell.wait(HEARTBEAT),
            }
            self.beat()?;
        }
    }

    fn take_orders(&mut self) -> Result<(), ExitError> {
        loop {
            match self.orders.try_receive() {
                Ok(None) => return Ok(()),
                Ok(Some(Order::Rollout {
                    worker,
                    incarnation,
                    iteration,
                    policy_version,
                    shards,
                })) if (worker, incarnation) == (self.id, self.incarnation) => {
                    for shard in shards {
                        self.add(Job::Rollout(Block { iteration, policy_version, shard }));
                    }
                }
                Ok(Some(Order::Evaluate { worker, incarnation, episodes }))
                    if (worker, incarnation) == (self.id, self.incarnation) =>
                {
                    self.add(Job::Evaluation(episodes));
                }
                Ok(Some(Order::Leave { worker, incarnation }))
                    if (worker, incarnation) == (self.id, self.incarnation) =>
                {
                    self.stopping = true;
                }
                Ok(Some(Order::Stop)) => self.stopping = true,
                Ok(Some(_)) => {}
                // A garbled message is reported and passed over; its order will be sent again.
                Err(error @ ChannelError::Decode { .. }) => self.fail(&error.to_string(), None)?,
                Err(error) => return Err(failure(&error)),
            }
        }
    }

    /// A re-sent order for what still waits is the same order.
    fn add(&mut self, job: Job) {
        if !self.jobs.contains(&job) {
            self.jobs.push_back(job);
        }
    }

    fn take_policies(&mut self) -> Result<(), ExitError> {
        while let Some(sample) = self.policy.try_receive().map_err(|error| failure(&error))? {
            let version = sample.header().version;
            match self.world.policy(sample.payload()) {
                Ok(policy) => {
                    self.policies.retain(|(held, _)| *held != version);
                    self.policies.push_back((version, policy));
                    self.policies.make_contiguous().sort_by_key(|(held, _)| *held);
                    while self.policies.len() > KEPT_POLICIES {
                        self.policies.pop_front();
                    }
                }
                Err(error) => self.fail(&format!("policy version {version}: {error}"), None)?,
            }
        }
        Ok(())
    }

    /// The first job whose policy is here. Jobs whose policy will come wait for it; evaluations
    /// whose policy is gone for good are next, too, to be answered.
    fn next_job(&mut self) -> Option<Job> {
        let held = |version: u64| self.policies.iter().any(|(held, _)| *held == version);
        let oldest = self.policies.front().map_or(0, |(held, _)| *held);
        let index = self.jobs.iter().position(|job| {
            let version = job.policy_version();
            held(version) || (matches!(job, Job::Evaluation(_)) && version < oldest)
        })?;
        self.jobs.remove(index)
    }

    /// Plays episodes of the run's own evaluation.
    fn evaluate(&mut self, chunk: EvaluationChunk) -> Result<(), ExitError> {
        let policy = self.policies.iter().find(|(held, _)| *held == chunk.policy_version);
        let alive = self.alive();
        let (status, heartbeat) = (&self.status, &mut self.heartbeat);
        let mut on_step = || say_alive(status, heartbeat, &alive);
        let errors = policy.map(|(_, policy)| {
            evaluate::select(self.world, policy, chunk.first, chunk.episodes, &mut on_step)
        });
        let errors = match errors {
            Some(Ok(errors)) => errors,
            None => Vec::new(),
            Some(Err(error)) => {
                let what = format!("evaluation of policy {}: {error}", chunk.policy_version);
                self.fail(&what, None)?;
                Vec::new()
            }
        };
        let (worker, incarnation) = (self.id, self.incarnation);
        self.send(&Status::EvaluationDone { worker, incarnation, chunk, errors })
    }

    fn make(&mut self, job: Block) -> Result<Outcome, ExitError> {
        let Block { iteration, policy_version, shard } = job;
        fault::meet(iteration, shard);
        let mut block = self.blocks.loan().map_err(|error| failure(&error))?;
        let policy = self.policies.iter().find(|(held, _)| *held == policy_version);
        let Some((_, policy)) = policy else {
            return Ok(Outcome::Unclaimed);
        };
        let spec = RolloutSpec { seed: self.world.config.run.seed, iteration, shard, policy };
        let start = Instant::now();
        let alive = self.alive();
        let (status, heartbeat) = (&self.status, &mut self.heartbeat);
        let mut on_stage = |_| say_alive(status, heartbeat, &alive);
        if let Err(error) = rollout(self.world, &spec, block.payload_mut(), &mut on_stage) {
            self.fail(&error.to_string(), Some(Box::new(describe(job, &error))))?;
            return Ok(Outcome::Done);
        }
        let rollout_ns = start.elapsed().as_nanos() as u64;
        *block.header_mut() = BlockHeader {
            iteration,
            policy_version,
            shard,
            worker: self.id,
            incarnation: self.incarnation,
            n_envs: self.world.dimensions.n_envs as u32,
            n_steps: self.world.dimensions.n_steps as u32,
            reserved: 0,
            rollout_ns,
        };
        match self.blocks.send(block) {
            Ok(0) => {
                tracing::warn!(iteration, shard, "no learner took the block; making it again");
                return Ok(Outcome::Unclaimed);
            }
            Ok(_) => {}
            Err(error) => return Err(failure(&error)),
        }
        let (worker, incarnation) = (self.id, self.incarnation);
        self.send(&Status::BlockDone {
            worker,
            incarnation,
            iteration,
            shard,
            env_steps: self.world.block_env_steps(),
            rollout_ns,
        })?;
        tracing::debug!(iteration, shard, policy_version, rollout_ns, "block sent");
        Ok(Outcome::Done)
    }

    fn beat(&mut self) -> Result<(), ExitError> {
        if self.heartbeat.elapsed() < HEARTBEAT {
            return Ok(());
        }
        self.heartbeat = Instant::now();
        self.send(&self.alive())
    }

    fn alive(&self) -> Status {
        let (worker, incarnation, orders) = (self.id, self.incarnation, self.orders.port());
        Status::Heartbeat { worker, incarnation, orders }
    }

    fn fail(&self, what: &str, fault: Option<Box<Fault>>) -> Result<(), ExitError> {
        tracing::error!(worker = self.id, "{what}");
        self.send(&Status::Failed {
            worker: self.id,
            incarnation: self.incarnation,
            message: message::clip(what),
            fault,
        })
    }

    fn send(&self, status: &Status) -> Result<(), ExitError> {
        self.status.send(status).map_err(|error| failure(&error))
    }
}

/// Says so if it has not been said for a while.
fn say_alive(status: &MessageSender<Status>, heartbeat: &mut Instant, alive: &Status) {
    if heartbeat.elapsed() >= HEARTBEAT {
        *heartbeat = Instant::now();
        // A lost heartbeat is followed by another; a broken channel shows at the next send.
        let _ = status.send(alive);
    }
}

/// A block that cannot be made, for the coordinator to write down.
fn describe(job: Block, error: &RolloutError) -> Fault {
    let source = match error {
        RolloutError::Episode { source, .. } => Some(source),
        _ => None,
    };
    Fault {
        iteration: job.iteration,
        shard: job.shard,
        policy_version: job.policy_version,
        env: source.map(EpisodeError::env),
        step: source.map(|error| error.step() as u32),
        environment: source
            .and_then(EpisodeError::moment)
            .map_or_else(BTreeMap::new, Moment::arrays),
    }
}

fn failure(error: &ChannelError) -> ExitError {
    let code = match error {
        ChannelError::Full { .. } => ExitCode::Environment,
        _ => ExitCode::Failure,
    };
    ExitError::new(code, error.to_string())
}

mod fault;

#[cfg(test)]
mod tests;
