//! A shard: which block is asked for, and the episodes that make it.

use proto::rng::Purpose;

use super::batch::{Batch, Episodes, Stage};
use super::explore::Noise;
use super::output::Output;
use super::{RolloutError, World};
use crate::env::EpisodeError;
use crate::policy::Policy;
use crate::scalar::{Backend, dispatch_for};
use crate::task::goal::GoalAddress;

/// Which block.
#[derive(Debug, Clone, Copy)]
pub struct RolloutSpec<'a> {
    /// Seed of the run.
    pub seed: u64,
    /// Iteration of the run.
    pub iteration: u64,
    /// The shard.
    pub shard: u32,
    /// The policy to act with.
    pub policy: &'a Policy,
}

/// Rolls out a shard: N environments, one whole episode each, into `block`.
///
/// `on_stage` is called after every part of a control step, for a worker to say that it is alive and
/// for a benchmark to look at its clock; it cannot change the result.
pub fn rollout(
    world: &World,
    spec: &RolloutSpec<'_>,
    block: &mut [f32],
    on_stage: &mut dyn FnMut(Stage),
) -> Result<(), RolloutError> {
    rollout_on(Backend::detect(), world, spec, block, on_stage)
}

/// [`rollout`] on a chosen back end; all give the same bits.
pub fn rollout_on(
    backend: Backend,
    world: &World,
    spec: &RolloutSpec<'_>,
    block: &mut [f32],
    on_stage: &mut dyn FnMut(Stage),
) -> Result<(), RolloutError> {
    let job = prepare(world, spec, block, on_stage)?;
    finish(spec, dispatch_for(world.dimensions.n_envs, backend, job))
}

/// The rollout with one environment a lane in `S` itself: the readable twin for tests.
#[cfg(test)]
pub(crate) fn rollout_with<S: crate::scalar::Real>(
    world: &World,
    spec: &RolloutSpec<'_>,
    block: &mut [f32],
) -> Result<(), RolloutError> {
    use crate::scalar::LaneFn;
    let mut on_stage = |_| {};
    let job = prepare(world, spec, block, &mut on_stage)?;
    finish(spec, job.call::<S>())
}

fn prepare<'a>(
    world: &'a World,
    spec: &RolloutSpec<'a>,
    block: &'a mut [f32],
    on_stage: &'a mut dyn FnMut(Stage),
) -> Result<Episodes<'a>, RolloutError> {
    let RolloutSpec { seed, iteration, shard, policy } = *spec;
    let dimensions = &world.dimensions;
    let Ok(address_iteration) = u32::try_from(iteration) else {
        return Err(RolloutError::NoSuchIteration { iteration });
    };
    if shard as usize >= dimensions.n_shards {
        return Err(RolloutError::NoSuchShard { shard, iteration, n_shards: dimensions.n_shards });
    }
    if block.len() != world.layout.len {
        return Err(RolloutError::BlockLength { found: block.len(), expected: world.layout.len });
    }
    if (policy.n_actors(), policy.input()) != (dimensions.n_actors, dimensions.actor_input()) {
        return Err(RolloutError::PolicyShape {
            found_actors: policy.n_actors(),
            found_input: policy.input(),
            actors: dimensions.n_actors,
            input: dimensions.actor_input(),
        });
    }
    let first = shard * dimensions.n_envs as u32;
    Ok(Episodes {
        config: &world.config,
        robot: &world.robot,
        task: &world.task,
        dimensions,
        policy,
        batch: Batch { first, n_envs: dimensions.n_envs, n_steps: dimensions.n_steps },
        goals: GoalAddress {
            seed,
            purpose: Purpose::Goal,
            iteration: address_iteration,
            env: first,
        },
        noise: Noise {
            seed,
            iteration: address_iteration,
            exploration: world.config.exploration(iteration),
        },
        output: Output { layout: &world.layout, block },
        on_stage,
    })
}

fn finish(spec: &RolloutSpec<'_>, result: Result<(), EpisodeError>) -> Result<(), RolloutError> {
    let RolloutSpec { seed, iteration, shard, .. } = *spec;
    result.map_err(|source| RolloutError::Episode { seed, iteration, shard, source })
}
