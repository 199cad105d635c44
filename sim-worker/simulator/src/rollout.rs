//! The rollout: a pure function from a run's seed, an iteration, a shard and a policy to a block.
//!
//! Nothing outlives a call, so any worker can make any block, twice if need be, with the same bits.
//! Goals and exploration noise are drawn by address (see [`proto::rng`]), from the environment's
//! **global** index shard · N + n, and environments never mix in the arithmetic: the rows of an
//! environment are the same bits in whatever shard, lane or process it is rolled out.
//!
//! **Episodes never cross blocks.** The released code resets every 512 steps across rollouts of 50. Here every
//! rollout is whole episodes, so a worker needs no memory between two orders.

use proto::config::Config;
use proto::layout::{BlockLayout, Dimensions};
use proto::rng::Purpose;

use crate::env::{Batch, EpisodeError, Episodes, Noise, Output, Stage};
use crate::policy::{Policy, PolicyError};
use crate::robot::Robot;
use crate::scalar::{Backend, dispatch_for};
use crate::task::Task;
use crate::task::goal::GoalAddress;

/// Everything of a run that rollouts share and that never changes.
#[derive(Debug, Clone)]
pub struct World {
    /// The configuration.
    pub config: Config,
    /// The sizes that follow.
    pub dimensions: Dimensions,
    /// The robot.
    pub robot: Robot,
    /// The task on this robot.
    pub task: Task,
    layout: BlockLayout,
}

impl World {
    /// The world of a configuration and a robot.
    pub fn new(config: &Config, robot: &Robot) -> Self {
        let dimensions = Dimensions::new(config, robot.n_arms);
        Self {
            config: config.clone(),
            dimensions,
            robot: robot.clone(),
            task: Task::new(config, crate::env::home(robot)),
            layout: BlockLayout::new(&dimensions),
        }
    }

    /// Env-steps of a block.
    pub fn block_env_steps(&self) -> u64 {
        (self.dimensions.n_envs * self.dimensions.n_steps) as u64
    }

    /// Where the arrays of a block stand.
    pub fn block_layout(&self) -> &BlockLayout {
        &self.layout
    }

    /// Checks and packs the parameters of a policy version.
    pub fn policy(&self, parameters: &[f32]) -> Result<Policy, PolicyError> {
        Policy::new(&self.config, &self.dimensions, parameters)
    }
}

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

/// Why a block could not be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RolloutError {
    /// The order does not fit the configuration.
    #[error("shard {shard} of iteration {iteration} does not exist: the run has {n_shards} shards")]
    NoSuchShard {
        /// The shard asked for.
        shard: u32,
        /// The iteration asked for.
        iteration: u64,
        /// Shards of the run.
        n_shards: usize,
    },
    /// Random numbers have no addresses that far.
    #[error("iteration {iteration} does not exist: random numbers are addressed for 2³² of them")]
    NoSuchIteration {
        /// The iteration asked for.
        iteration: u64,
    },
    /// The memory for the block has another size than the layout.
    #[error("the block has {found} numbers, the configuration's layout has {expected}")]
    BlockLength {
        /// Numbers of the slice.
        found: usize,
        /// Numbers of the layout.
        expected: usize,
    },
    /// The policy is one of another configuration.
    #[error(
        "the policy has {found_actors} actors that see {found_input} numbers; the run has \
         {actors} that see {input}"
    )]
    PolicyShape {
        /// Actors of the policy.
        found_actors: usize,
        /// Inputs of their networks.
        found_input: usize,
        /// Actors of the run.
        actors: usize,
        /// Numbers that they see.
        input: usize,
    },
    /// An episode went wrong.
    #[error("seed {seed}, iteration {iteration}, shard {shard}: {source}")]
    Episode {
        /// Seed of the run.
        seed: u64,
        /// The iteration.
        iteration: u64,
        /// The shard.
        shard: u32,
        /// What, where and when.
        source: EpisodeError,
    },
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

#[cfg(test)]
mod tests;
