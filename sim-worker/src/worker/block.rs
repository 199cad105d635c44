//! Making a block.

use std::collections::BTreeMap;
use std::time::Instant;

use proto::ExitError;
use proto::layout::BlockHeader;
use proto::message::{Fault, Status};
use simulator::env::{EpisodeError, Moment};
use simulator::rollout::{RolloutError, RolloutSpec, rollout};

use super::assignment::Block;
use super::fault_injection::{distort, inject_fault};
use super::process::{Worker, failure, say_alive};

/// What became of a block.
pub(super) enum Delivery {
    /// It was taken, or it cannot be made, which was said.
    Done,
    /// Nobody was there to take the block: make it again later.
    Unclaimed,
}

/// Rolls a block out and sends it.
pub(super) fn make_block(worker: &mut Worker<'_>, block: Block) -> Result<Delivery, ExitError> {
    let Block { iteration, policy_version, shard } = block;
    inject_fault(iteration, shard);
    let mut sample = worker.blocks.loan().map_err(|error| failure(&error))?;
    let policy = worker.policies.iter().find(|(held, _)| *held == policy_version);
    let Some((_, policy)) = policy else {
        return Ok(Delivery::Unclaimed);
    };
    let spec = RolloutSpec { seed: worker.world.config.run.seed, iteration, shard, policy };
    let start = Instant::now();
    let alive = worker.alive();
    let (status, heartbeat) = (&worker.status, &mut worker.heartbeat);
    let mut on_stage = |_| say_alive(status, heartbeat, &alive);
    if let Err(error) = rollout(worker.world, &spec, sample.payload_mut(), &mut on_stage) {
        worker.fail(&error.to_string(), Some(Box::new(describe(block, &error))))?;
        return Ok(Delivery::Done);
    }
    let rollout_ns = start.elapsed().as_nanos() as u64;
    distort(iteration, shard, sample.payload_mut());
    *sample.header_mut() = BlockHeader {
        iteration,
        policy_version,
        shard,
        worker: worker.id,
        incarnation: worker.incarnation,
        n_envs: worker.world.dimensions.n_envs as u32,
        n_steps: worker.world.dimensions.n_steps as u32,
        reserved: 0,
        rollout_ns,
    };
    match worker.blocks.send(sample) {
        Ok(0) => {
            tracing::warn!(iteration, shard, "no learner took the block; making it again");
            return Ok(Delivery::Unclaimed);
        }
        Ok(_) => {}
        Err(error) => return Err(failure(&error)),
    }
    worker.send(&Status::BlockDone {
        worker: worker.id,
        incarnation: worker.incarnation,
        iteration,
        shard,
        env_steps: worker.world.block_env_steps(),
        rollout_ns,
    })?;
    tracing::debug!(iteration, shard, policy_version, rollout_ns, "block sent");
    Ok(Delivery::Done)
}

/// A block that cannot be made, for the coordinator to write down.
fn describe(block: Block, error: &RolloutError) -> Fault {
    let source = match error {
        RolloutError::Episode { source, .. } => Some(source),
        _ => None,
    };
    Fault {
        iteration: block.iteration,
        shard: block.shard,
        policy_version: block.policy_version,
        env: source.map(EpisodeError::env),
        step: source.map(|error| error.step() as u32),
        environment: source
            .and_then(EpisodeError::moment)
            .map_or_else(BTreeMap::new, Moment::arrays),
    }
}
