//! The learner process: receives blocks, trains, publishes policies, reports, and sends snapshots.
//!
//! Two threads: this module's owns all ports and keeps receiving; the other one trains. While it
//! does, blocks of the next iteration are acknowledged and late workers get their policy.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use channels::{
    ArrayReceiver, ArraySample, ArraySender, BellListener, ChannelSizes, Channels, Domain,
    MessageReceiver, MessageSender, PieceSender, Role, WHILE_THE_PARENT_LIVES,
};
use process::input;
use proto::config::{Config, Run};
use proto::layout::{BlockHeader, Dimensions, PolicyHeader, SnapshotHeader};
use proto::message::{self, HEARTBEAT, IterationReport, Losses, Order, Progress, Timing};
use proto::run_dir::RunDir;
use proto::{Digest, ExitError};
use tch::Device;

use crate::LearnerError;
use crate::algorithm::Algorithm;
use crate::ingest::{Arrival, Inbox, errors};
use crate::precision::Arithmetic;
use crate::report::UpdateReport;
use crate::state::TrainingState;
use crate::state::image::Image;

/// How often a learner with nothing to do looks for workers that came late.
const IDLE: Duration = Duration::from_millis(20);
/// How long a piece of a snapshot waits for room before it is tried again later.
const PIECE_DEADLINE: Duration = Duration::from_millis(1);
/// How often it looks whether training is done.
const BUSY: Duration = Duration::from_millis(2);

/// Trains the policies of a SpaceOctopus run; started by `octopus`, not by hand.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "learner", version)]
pub struct Arguments {
    /// Run directory, holding config.toml and robot.toml.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// Name under which the run's shared memory lives.
    #[arg(long, value_name = "NAME")]
    pub domain: String,
    /// Training state to go on from.
    #[arg(long, value_name = "FILE")]
    pub resume: Option<PathBuf>,
    /// Process that started this one: the learner does not start if that is gone already.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
}

/// Learns until it is told to stop.
pub fn run(arguments: &Arguments) -> Result<(), ExitError> {
    process::child::die_with_parent(arguments.parent)?;
    let (config, dimensions) = load(&RunDir::new(&arguments.run_dir))?;
    let device = device(&config.run.device)?;
    let threads = i32::try_from(config.run.learner_threads).unwrap_or(i32::MAX);
    tch::set_num_threads(threads);
    tch::set_num_interop_threads(1);
    let arithmetic = Arithmetic::of(config.run.precision)?;
    let state = match &arguments.resume {
        None => TrainingState::initial(&config, &dimensions, arithmetic, device),
        Some(path) => {
            let data = read_state(path)?;
            let state = TrainingState::from_safetensors(&data, &config, &dimensions, device)
                .map_err(|error| LearnerError::State(format!("{}: {error}", path.display())))?;
            if state.arithmetic != arithmetic {
                return Err(LearnerError::State(format!(
                    "{}: was trained in {}, and run.precision is {}; is it a state of this run?",
                    path.display(),
                    state.arithmetic.as_str(),
                    arithmetic.as_str()
                ))
                .into());
            }
            state
        }
    };
    let mut ports = Ports::open(&arguments.domain, &config, &dimensions, state.iteration)?;
    let image;
    (image, ports.spare) = Image::new(&state);
    let mut learner = Learner {
        ports,
        image,
        dimensions,
        run: config.run.clone(),
        digest: state.digest(),
        trainer: Trainer { algorithm: Algorithm::new(&config, &dimensions, &state), state },
    };
    let result = learner.serve();
    if let Err(error) = &result {
        let message = message::clip(&error.to_string());
        // The coordinator may be gone; the error is returned either way.
        let _ = learner.ports.progress.send(&Progress::Failed { message });
    }
    Ok(result?)
}

/// Reads a training state. One that cannot be read is as one that cannot be restored: the coordinator goes on
/// from the one before.
fn read_state(path: &Path) -> Result<Vec<u8>, LearnerError> {
    input::read(path, input::STATE).map_err(|error| {
        LearnerError::State(format!("{}: cannot be read: {error}", path.display()))
    })
}

/// Reads configuration and robot of a run. Of the robot the learner needs the number of arms only.
pub fn load(run_dir: &RunDir) -> Result<(Config, Dimensions), LearnerError> {
    let text = |path: PathBuf| -> Result<(String, String), LearnerError> {
        match input::read_text(&path) {
            Ok(text) => Ok((text, path.display().to_string())),
            Err(source) => Err(LearnerError::File { path, source }),
        }
    };
    let (config, origin) = text(run_dir.config())?;
    let config = Config::from_resolved_toml(&config, &origin)?;
    let (robot, origin) = text(run_dir.robot())?;
    let robot: toml::Table = robot
        .parse()
        .map_err(|error| LearnerError::Robot(format!("{origin}: not valid TOML: {error}")))?;
    let arms = robot.get("arms").and_then(toml::Value::as_array).map_or(0, Vec::len);
    if arms == 0 {
        return Err(LearnerError::Robot(format!("{origin}: has no [[arms]]")));
    }
    let dimensions = Dimensions::new(&config, arms);
    Ok((config, dimensions))
}

/// The device called `name`, if it is there.
pub fn device(name: &str) -> Result<Device, LearnerError> {
    let Some(index) = name.strip_prefix("cuda:") else { return Ok(Device::Cpu) };
    let index: usize =
        index.parse().map_err(|_| LearnerError::Device(format!("`{name}` is no device")))?;
    if !cfg!(feature = "cuda") {
        return Err(LearnerError::Device(format!(
            "run.device is `{name}`, but this learner was built without CUDA; \
             `make setup DEVICE=cuda && make build` builds one with it, run.device=cpu does without"
        )));
    }
    let count = tch::Cuda::device_count() as usize;
    if !tch::Cuda::is_available() || index >= count {
        return Err(LearnerError::Device(format!(
            "run.device is `{name}`, but libtorch sees {count} CUDA devices; `nvidia-smi` lists \
             them, run.device=cpu does without"
        )));
    }
    Ok(Device::Cuda(index))
}

/// The process: what trains, and what talks.
struct Learner {
    trainer: Trainer,
    ports: Ports,
    image: Image,
    dimensions: Dimensions,
    run: Run,
    digest: Digest,
}

/// What the training thread borrows.
struct Trainer {
    algorithm: Algorithm,
    state: TrainingState,
}

/// Ports and what has come in through them. iceoryx2's ports stay on one thread.
struct Ports {
    inbox: Inbox<ArraySample<BlockHeader>>,
    /// Snapshots on their way, oldest first.
    outbox: VecDeque<Outgoing>,
    /// Memory of a snapshot that has been sent, for the next one.
    spare: Vec<u8>,
    heartbeat: Instant,
    wants_snapshot: bool,
    wants_stop: bool,
    orders: MessageReceiver<Order>,
    blocks: ArrayReceiver<BlockHeader>,
    policy: ArraySender<PolicyHeader>,
    progress: MessageSender<Progress>,
    snapshot: PieceSender,
    bell: BellListener,
    // Dropped last: ports must not outlive their services.
    _channels: Channels,
}

/// A snapshot of which the pieces before `header.offset` have been sent.
struct Outgoing {
    header: SnapshotHeader,
    bytes: Vec<u8>,
}

impl Ports {
    fn open(
        domain: &str,
        config: &Config,
        dimensions: &Dimensions,
        iteration: u64,
    ) -> Result<Self, LearnerError> {
        let domain = Domain::parse(domain)?;
        let channels = Channels::open(&domain, ChannelSizes::new(config, dimensions))?;
        Ok(Self {
            inbox: Inbox::new(config, dimensions, iteration),
            outbox: VecDeque::new(),
            spare: Vec::new(),
            heartbeat: Instant::now(),
            wants_snapshot: false,
            wants_stop: false,
            orders: channels.order_receiver()?,
            blocks: channels.block_receiver()?,
            policy: channels.policy_sender()?,
            progress: channels.progress_sender(WHILE_THE_PARENT_LIVES)?,
            snapshot: channels.snapshot_sender(PIECE_DEADLINE)?,
            bell: channels.listener(Role::Learner)?,
            _channels: channels,
        })
    }

    /// Takes in whatever has arrived.
    fn pump(&mut self) -> Result<(), LearnerError> {
        self.policy.update_connections();
        while let Some(order) = self.orders.try_receive()? {
            match order {
                Order::Snapshot => self.wants_snapshot = true,
                Order::Stop => self.wants_stop = true,
                _ => {}
            }
        }
        while let Some(block) = self.blocks.try_receive()? {
            let BlockHeader { iteration, shard, .. } = *block.header();
            let duplicate = self.inbox.receive(block)? == Arrival::Duplicate;
            self.progress.send(&Progress::BlockReceived { iteration, shard, duplicate })?;
        }
        self.send_piece()
    }

    /// Says once in a while that the process is alive.
    fn beat(&mut self) -> Result<(), LearnerError> {
        if self.heartbeat.elapsed() >= HEARTBEAT {
            self.heartbeat = Instant::now();
            self.progress.send(&Progress::Heartbeat)?;
        }
        Ok(())
    }

    /// Sends the next piece of the oldest snapshot, if there is room for it.
    fn send_piece(&mut self) -> Result<(), LearnerError> {
        let Some(Outgoing { header, bytes }) = self.outbox.front_mut() else { return Ok(()) };
        header.offset = self.snapshot.send(*header, bytes)?;
        if header.offset >= bytes.len() as u64
            && let Some(sent) = self.outbox.pop_front()
        {
            self.spare = sent.bytes;
        }
        Ok(())
    }

    /// Publishes a policy that `write` fills in, in shared memory.
    fn publish(&self, version: u64, write: impl FnOnce(&mut [f32])) -> Result<(), LearnerError> {
        let mut sample = self.policy.loan()?;
        write(sample.payload_mut());
        *sample.header_mut() = PolicyHeader { version };
        self.policy.send(sample)?;
        Ok(())
    }
}

impl Learner {
    fn serve(&mut self) -> Result<(), LearnerError> {
        let state = &self.trainer.state;
        if self.run.overlap > 0 && state.iteration > 0 {
            // Workers that overlap act with the version before the newest.
            let previous = &state.previous_policy;
            self.ports.publish(state.iteration - 1, |out| out.copy_from_slice(previous))?;
        }
        self.ports.publish(state.iteration, |out| state.write_policy(out))?;
        let precision = state.arithmetic.as_str();
        self.ports.progress.send(&Progress::Ready {
            iteration: state.iteration,
            env_steps: state.env_steps,
            digest: self.digest,
            precision: precision.to_owned(),
            orders: self.ports.orders.port(),
        })?;
        tracing::info!(iteration = state.iteration, digest = %self.digest, precision, "ready");
        let mut idle_since = Instant::now();
        loop {
            self.ports.pump()?;
            self.ports.beat()?;
            if self.ports.wants_snapshot {
                self.ports.wants_snapshot = false;
                self.take_snapshot();
            }
            if self.ports.wants_stop {
                return Ok(());
            }
            if self.ports.inbox.is_complete() {
                self.iterate(idle_since.elapsed())?;
                idle_since = Instant::now();
            } else {
                let busy = !self.ports.outbox.is_empty();
                self.ports.bell.wait(if busy { BUSY } else { IDLE });
            }
        }
    }

    /// Copies the state; its pieces are sent while training goes on. Whoever asks again while it is on
    /// its way gets this one.
    fn take_snapshot(&mut self) {
        let state = &self.trainer.state;
        if self.ports.outbox.back().is_some_and(|last| last.header.iteration == state.iteration) {
            return;
        }
        let header = SnapshotHeader {
            iteration: state.iteration,
            digest: self.digest.0,
            ..SnapshotHeader::default()
        };
        let mut bytes = std::mem::take(&mut self.ports.spare);
        self.image.write(state, &mut bytes);
        self.ports.outbox.push_back(Outgoing { header, bytes });
    }

    /// Trains on the complete iteration, publishes, reports.
    fn iterate(&mut self, waited: Duration) -> Result<(), LearnerError> {
        let iteration = self.trainer.state.iteration;
        let samples = self.ports.inbox.take();
        let policy_version = samples[0].header().policy_version;
        let rollout_ns: u64 = samples.iter().map(|sample| sample.header().rollout_ns).sum();
        let shards: Vec<&[f32]> = samples.iter().map(ArraySample::payload).collect();

        let begun = Instant::now();
        let update = self.train(&shards)?;
        let update_s = begun.elapsed().as_secs_f64();
        let errors = errors(&self.dimensions, &shards);
        drop(samples);

        let state = &self.trainer.state;
        let begun = Instant::now();
        self.ports.publish(state.iteration, |out| state.write_policy(out))?;
        let publish_s = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        self.digest = state.digest();
        let digest_s = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        if self.run.plans_snapshot(self.trainer.state.iteration) {
            // One that was asked for meanwhile would be the same.
            self.ports.wants_snapshot = false;
            self.take_snapshot();
        }
        let copy_s = begun.elapsed().as_secs_f64();
        let state = &self.trainer.state;

        let mut report = report(&update);
        report.iteration = iteration;
        report.env_steps = state.env_steps;
        report.digest = self.digest;
        report.policy_version = policy_version;
        report.errors = errors;
        report.accounting = self.ports.inbox.account(iteration);
        report.timing = Timing {
            wait_s: waited.as_secs_f64(),
            update_s,
            publish_s,
            digest_s,
            copy_s,
            rollout_s: rollout_ns as f64 * 1e-9,
        };
        Ok(self.ports.progress.send(&Progress::IterationDone(Box::new(report)))?)
    }

    /// Updates on a thread of its own, and keeps receiving meanwhile.
    fn train(&mut self, shards: &[&[f32]]) -> Result<UpdateReport, LearnerError> {
        let Self { trainer: Trainer { algorithm, state }, ports, .. } = self;
        let work = algorithm.work();
        std::thread::scope(|scope| {
            let update = scope.spawn(move || algorithm.update(state, shards));
            let mut received = Ok(());
            let mut worked = work.load(Ordering::Relaxed);
            while !update.is_finished() {
                if received.is_ok() {
                    received = ports.pump();
                }
                // An update that stands still shall be found out, so it is no sign of life that
                // this thread is well.
                let now = work.load(Ordering::Relaxed);
                if received.is_ok() && now != worked {
                    worked = now;
                    received = ports.beat();
                }
                ports.bell.wait(BUSY);
            }
            let updated = update.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            received.and(updated)
        })
    }
}

/// What the update says, as the coordinator gets it.
fn report(update: &UpdateReport) -> IterationReport {
    let mean = |values: &[f64]| (values.iter().sum::<f64>() / values.len() as f64) as f32;
    IterationReport {
        returns: update.returns.iter().map(|&x| x as f32).collect(),
        losses: Losses {
            policy: mean(&update.policy_loss),
            value: mean(&update.value_loss),
            entropy: mean(&update.entropy),
            kl: mean(&update.kl),
            clip_fraction: mean(&update.clip_fraction),
            explained_variance: mean(&update.explained_variance),
            actor_grad_norm: mean(&update.actor_grad_norm),
            critic_grad_norm: mean(&update.critic_grad_norm),
        },
        actor_lr: update.actor_lr,
        critic_lr: update.critic_lr,
        action_std: mean(&update.action_std),
        ..IterationReport::default()
    }
}

#[cfg(test)]
mod tests {
    use proto::ExitCode;

    use super::*;

    /// A checkpoint that was removed while a learner started from it once ended the run.
    #[test]
    fn a_state_that_cannot_be_read_is_told_from_other_bad_input() {
        let dir = tempfile::tempdir().expect("tempdir");
        for path in [dir.path().join("gone.safetensors"), dir.path().to_owned()] {
            let error = ExitError::from(read_state(&path).expect_err("nothing to read"));
            assert_eq!(error.code, ExitCode::RunDirectory, "{error}");
            assert!(error.message.starts_with("training state: "), "{error}");
            assert!(error.message.contains(&path.display().to_string()), "{error}");
        }
        let error = ExitError::from(load(&RunDir::new(dir.path())).expect_err("no run"));
        assert_eq!(error.code, ExitCode::BadInput, "the state is not to blame: {error}");
        assert!(error.message.contains("config.toml"), "{error}");
    }
}
