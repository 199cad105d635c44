//! Control messages: small, rare, encoded with bincode. Bulk data travels as flat arrays instead,
//! see [`crate::layout`].
//!
//! An iteration k, message by message:
//!
//! 1. The coordinator sends [`Order::Rollout`] for every shard of k, to workers that have room.
//! 2. A worker rolls the shard out, sends the block to the learner and [`Status::BlockDone`] to
//!    the coordinator. It keeps nothing: the same order again gives the same block.
//! 3. The learner answers each block with [`Progress::BlockReceived`].
//! 4. With all shards in, the learner trains, publishes policy k + 1 and sends
//!    [`Progress::IterationDone`].
//!
//! With overlap the orders of k + 1 go out as soon as all blocks of k are received; they name the
//! policy version that [`policy_version_for`] says.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::Digest;

/// Numbers a worker process; stays the same when the process is replaced.
pub type WorkerId = u32;

/// Numbers a host: another machine whose workers help a run.
pub type HostId = u32;

/// Workers of this machine have numbers below this one; those of host h, which counts from 1, begin at h times this.
pub const WORKERS_OF_A_HOST: WorkerId = 1000;

/// Incarnations that one gateway gives to workers of hosts: those of the gateway that is the i-th, from 0, begin at i times
/// this.
pub const INCARNATIONS_OF_A_GATEWAY: u32 = 1 << 20;

/// The host of a worker; none if it is one of this machine.
pub fn host_of(worker: WorkerId) -> Option<HostId> {
    (worker >= WORKERS_OF_A_HOST).then_some(worker / WORKERS_OF_A_HOST)
}

/// A membership of another machine: the gateway that it came by, and its number there. Another gateway gives that number to another
/// machine.
pub type Membership = (u32, HostId);

/// The membership of a worker in an incarnation; none if it is one of this machine.
pub fn membership_of(worker: WorkerId, incarnation: u32) -> Option<Membership> {
    Some((incarnation / INCARNATIONS_OF_A_GATEWAY, host_of(worker)?))
}

/// Names one end of a channel, of one process.
pub type PortId = u128;

/// How often a worker, and a learner that gets on, says that it is alive.
pub const HEARTBEAT: Duration = Duration::from_millis(500);

/// The policy version that iteration `iteration` is rolled out with.
///
/// Without overlap it is the newest one, `iteration`. With overlap the workers roll out while the
/// learner still trains on the iteration before, so they use the one before: 0, 0, 1, 2, …
pub fn policy_version_for(iteration: u64, overlap: usize) -> u64 {
    iteration.saturating_sub(overlap as u64)
}

/// Coordinator → workers and learner. Each receiver takes what is addressed to it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Order {
    /// Worker `worker` shall roll out `shards` of `iteration`, in this order.
    Rollout {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation: an order to a predecessor is not for its successor.
        incarnation: u32,
        /// The iteration.
        iteration: u64,
        /// The policy version to act with.
        policy_version: u64,
        /// The shards.
        shards: Vec<u32>,
    },
    /// Worker `worker`, one of a host, shall roll out a shard for comparison: its block does not go to the learner, and the
    /// gateway answers with [`Status::Audited`]. The host is not told what it is for.
    Audit {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// The iteration.
        iteration: u64,
        /// The policy version to act with.
        policy_version: u64,
        /// The shard.
        shard: u32,
    },
    /// Worker `worker` shall play episodes of an evaluation with the policy's mean actions.
    Evaluate {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// Which episodes.
        episodes: EvaluationChunk,
    },
    /// Worker `worker` shall finish what is at hand and exit: the run wants fewer.
    Leave {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
    },
    /// The gateway shall have a host have so many workers.
    ScaleHost {
        /// The host.
        host: HostId,
        /// Workers wanted.
        workers: u32,
    },
    /// The gateway shall have no host of this name from now on.
    Refuse {
        /// What the host calls itself.
        name: String,
    },
    /// The learner shall drop the blocks of a host that it has not begun to train on, and all that come later: it has been
    /// found to make other bits, or none.
    Discard {
        /// The host.
        host: HostId,
        /// Incarnation of the gateway that it came by; another one gives its number to another host.
        gateway: u32,
    },
    /// The learner shall send a snapshot of its state beside those that the configuration plans: at
    /// once if it is between iterations, otherwise after the iteration that it trains on.
    Snapshot,
    /// Everybody shall finish what is at hand and exit; machines that help shall wait for a run that was stopped.
    Stop(RunEnd),
}

/// Why everybody shall exit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RunEnd {
    /// As was planned.
    Over,
    /// A signal has stopped the run before its budget was done; it may be resumed.
    Stopped,
}

/// Episodes `first..first + episodes` of the held-out evaluation of a policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct EvaluationChunk {
    /// The policy.
    pub policy_version: u64,
    /// First episode, which is also the address of its goal.
    pub first: u32,
    /// Number of episodes.
    pub episodes: u32,
}

/// Errors of one held-out episode, means over hands.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EpisodeErrors {
    /// Means over its last steps.
    pub tail: TaskErrors,
    /// Minima over its steps, of each hand by itself: the paper's measure.
    pub min: TaskErrors,
}

/// How far from its goal a robot is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TaskErrors {
    /// Position error (m).
    pub position: f32,
    /// Orientation error (rad).
    pub orientation: f32,
    /// Attitude error of the base (rad).
    pub base: f32,
}

/// A block that could not be made, with the environment as it was before the step that failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Iteration of the block.
    pub iteration: u64,
    /// Its shard.
    pub shard: u32,
    /// The policy it was made with.
    pub policy_version: u64,
    /// Global index of the environment.
    pub env: Option<u32>,
    /// Control step.
    pub step: Option<u32>,
    /// State, goals and command by name, in the units of `sim-worker`.
    pub environment: BTreeMap<String, Vec<f32>>,
}

/// Learner → coordinator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Progress {
    /// The learner is up and has published policy `iteration`.
    Ready {
        /// Iterations trained on so far: 0, or what the resumed state says.
        iteration: u64,
        /// Env-steps trained on so far.
        env_steps: u64,
        /// Digest of its state.
        digest: Digest,
        /// The arithmetic in use: `f32` or `bf16`.
        precision: String,
        /// Where it takes orders.
        orders: PortId,
    },
    /// The learner is alive: sent about twice a second while it waits, and while its update moves on.
    Heartbeat,
    /// A block has arrived.
    BlockReceived {
        /// Its iteration.
        iteration: u64,
        /// Its shard.
        shard: u32,
        /// Who made it.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// Whether it was there already, or its iteration is over.
        duplicate: bool,
        /// Digest of its numbers.
        digest: Digest,
    },
    /// A block that had arrived was dropped, as [`Order::Discard`] said.
    BlockDiscarded {
        /// Its iteration.
        iteration: u64,
        /// Its shard.
        shard: u32,
    },
    /// An iteration is trained on, and policy `iteration + 1` is published.
    IterationDone(Box<IterationReport>),
    /// The learner cannot go on.
    Failed {
        /// Why.
        message: String,
    },
}

/// Worker → coordinator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Status {
    /// The worker is up.
    Ready {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// Where it takes orders.
        orders: PortId,
    },
    /// The worker is alive, sent every [`HEARTBEAT`] or so.
    Heartbeat {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// Where it takes orders: [`Status::Ready`] may have been pushed out of the queue of a coordinator
        /// that stood still.
        orders: PortId,
    },
    /// A block has been sent.
    BlockDone {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// The iteration.
        iteration: u64,
        /// The shard.
        shard: u32,
        /// Env-steps in the block.
        env_steps: u64,
        /// Time that the rollout took (ns).
        rollout_ns: u64,
    },
    /// What a worker of a host has made for [`Order::Audit`].
    Audited {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// The iteration.
        iteration: u64,
        /// The shard.
        shard: u32,
        /// Digest of the block's numbers.
        digest: Digest,
    },
    /// Episodes of an evaluation have been played.
    EvaluationDone {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// Which.
        chunk: EvaluationChunk,
        /// One entry an episode; none if the policy was gone or has diverged.
        errors: Vec<EpisodeErrors>,
    },
    /// The worker cannot make a block, or has met something that should not be.
    Failed {
        /// The worker.
        worker: WorkerId,
        /// Its incarnation.
        incarnation: u32,
        /// Why, with seed, iteration, shard, environment and step where they are known.
        message: String,
        /// The block and the environment, if it is about one.
        fault: Option<Box<Fault>>,
    },
    /// The gateway is alive, and these hosts are there: sent every [`HEARTBEAT`] or so and at each change. It is always
    /// the whole list, so that one that is lost takes nothing with it.
    Hosts {
        /// The gateway's incarnation.
        incarnation: u32,
        /// Where it takes the orders for all workers of hosts.
        orders: PortId,
        /// How many names it refuses, see [`Order::Refuse`].
        refused: u32,
        /// The hosts that have workers now.
        hosts: Vec<HostReport>,
    },
}

/// A host as the gateway sees it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HostReport {
    /// Its number.
    pub host: HostId,
    /// What it calls itself.
    pub name: String,
    /// Whether its processor is of another type than that of the run's machine.
    pub is_other_processor: bool,
    /// How many workers it is to have.
    pub wanted: u32,
    /// How many it can have at most.
    pub most: u32,
    /// Its workers that take orders, with their incarnations.
    pub workers: Vec<(WorkerId, u32)>,
    /// Blocks that came from it whole.
    pub blocks: u64,
    /// Bytes of these.
    pub bytes: u64,
    /// Pieces of blocks that were waited for and did not come.
    pub missing: u64,
}

/// What an iteration did. Becomes a line of `metrics.jsonl`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct IterationReport {
    /// The iteration, from 0.
    pub iteration: u64,
    /// Env-steps trained on, this iteration included.
    pub env_steps: u64,
    /// Digest of the training state after the iteration.
    pub digest: Digest,
    /// Policy version that collected the samples.
    pub policy_version: u64,
    /// Mean return of an episode, for each agent (undiscounted).
    pub returns: Vec<f32>,
    /// Losses and diagnostics.
    pub losses: Losses,
    /// Errors over the iteration's episodes, with exploration noise.
    pub errors: Errors,
    /// Learning rates in force.
    pub actor_lr: f64,
    /// Learning rate of critics in force.
    pub critic_lr: f64,
    /// Mean standard deviation of the actions.
    pub action_std: f32,
    /// What became of every env-step.
    pub accounting: Accounting,
    /// Where the learner's time went.
    pub timing: Timing,
}

/// Losses and diagnostics, means over agents and optimiser steps.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Losses {
    /// Clipped surrogate, negated.
    pub policy: f32,
    /// Value loss.
    pub value: f32,
    /// Entropy of the action distribution (nats).
    pub entropy: f32,
    /// KL divergence from the sampling policy, estimator k3 of Schulman (nats), over the steps before `algorithm.max_kl` ends them; MADDPG has none.
    pub kl: f32,
    /// Share of samples whose ratio was clipped.
    pub clip_fraction: f32,
    /// 1 − Var(return − value) / Var(return), before the update.
    pub explained_variance: f32,
    /// Global gradient norm of the actors before clipping.
    pub actor_grad_norm: f32,
    /// Global gradient norm of the critics before clipping.
    pub critic_grad_norm: f32,
}

/// Means over hands and episodes of an iteration.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Errors {
    /// Position error after the last step (m).
    pub position: f32,
    /// Orientation error after the last step (rad).
    pub orientation: f32,
    /// Attitude error of the base after the last step (rad).
    pub base: f32,
    /// Share of steps that end with any bodies touching.
    pub contact_rate: f32,
}

/// Env-steps of an iteration, by fate: `received = trained + duplicate`, and with what the
/// coordinator knows, `produced = received + lost`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Accounting {
    /// Sent by workers, as far as the coordinator was told; filled in by the coordinator.
    pub produced: u64,
    /// Arrived at the learner, and what hosts made for comparison.
    pub received: u64,
    /// Trained on.
    pub trained: u64,
    /// Arrived twice or made for comparison; identical, dropped.
    pub duplicate: u64,
    /// Died with a worker, belonged to an iteration that was over, or came from a host that makes other bits; filled in by
    /// the coordinator.
    pub lost: u64,
}

/// Seconds of the learner's time, by stage.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Waiting for blocks.
    pub wait_s: f64,
    /// Updating.
    pub update_s: f64,
    /// Publishing the policy.
    pub publish_s: f64,
    /// Computing the digest.
    pub digest_s: f64,
    /// Copying the state for a snapshot.
    pub copy_s: f64,
    /// Sum of the workers' rollout times of the blocks trained on.
    pub rollout_s: f64,
}

/// Encodes a message.
pub fn encode<M: Serialize>(message: &M) -> Vec<u8> {
    bincode::serde::encode_to_vec(message, bincode::config::standard())
        .expect("messages hold only types that bincode can encode")
}

/// Decodes a message; every byte must belong to it.
pub fn decode<M: for<'de> Deserialize<'de>>(bytes: &[u8]) -> Result<M, String> {
    let limit = bincode::config::standard().with_limit::<{ MAX_MESSAGE_LEN }>();
    match bincode::serde::decode_from_slice(bytes, limit) {
        Ok((message, used)) if used == bytes.len() => Ok(message),
        Ok((_, used)) => Err(format!("{} bytes left over", bytes.len() - used)),
        Err(error) => Err(error.to_string()),
    }
}

/// What a decoder is willing to read (bytes): more than any channel carries.
const MAX_MESSAGE_LEN: usize = 64 * 1024;

/// Cuts a text that came from anywhere to what fits in a status message: 2,000 bytes.
pub fn clip(text: &str) -> String {
    match text.floor_char_boundary(2000) {
        end if end < text.len() => format!("{}…", &text[..end]),
        _ => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn with_overlap_workers_act_with_the_policy_before() {
        assert_eq!([0, 1, 2, 3].map(|k| policy_version_for(k, 0)), [0, 1, 2, 3]);
        assert_eq!([0, 1, 2, 3].map(|k| policy_version_for(k, 1)), [0, 0, 1, 2]);
    }

    #[test]
    fn a_report_round_trips() {
        let report = IterationReport {
            iteration: 7,
            returns: vec![1.5, -2.0],
            digest: Digest([3; 16]),
            ..IterationReport::default()
        };
        let message = Progress::IterationDone(Box::new(report));
        assert_eq!(decode::<Progress>(&encode(&message)), Ok(message));
    }

    proptest! {
        #[test]
        fn orders_round_trip(
            worker in 0u32..9, iteration: u64, shards in prop::collection::vec(any::<u32>(), 0..20)
        ) {
            let order =
                Order::Rollout { worker, incarnation: 1, iteration, policy_version: 3, shards };
            prop_assert_eq!(decode::<Order>(&encode(&order)), Ok(order));
        }

        #[test]
        fn hostile_bytes_are_refused_or_decoded_but_never_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..200)
        ) {
            let _ = decode::<Order>(&bytes);
            let _ = decode::<Progress>(&bytes);
            let _ = decode::<Status>(&bytes);
        }
    }
}
