//! A block of a run, made again: what a worker sent to the learner, from its address alone.

use proto::Digest;
use proto::layout::BlockLayout;
use serde::{Deserialize, Serialize};
use simulator::experiment::Member;
use simulator::rollout::{RolloutSpec, rollout};

/// Which block; the policy's configuration names the seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Wanted {
    /// Iteration of the run.
    iteration: u64,
    /// The shard.
    shard: u32,
}

/// What the block is.
#[derive(Debug, Serialize)]
struct Made {
    seed: u64,
    digest: Digest,
    env_steps: u64,
    /// Undiscounted return of an episode, mean over environments, an agent each.
    returns: Vec<f64>,
}

/// Rolls it out with what acted in it, and describes it in JSON.
///
/// # Errors
/// If the run has no such block, or it cannot be made.
pub(crate) fn make(member: &Member, wanted: Wanted) -> Result<String, String> {
    let Member { world, policy } = member;
    let Wanted { iteration, shard } = wanted;
    let seed = world.config.run.seed;
    let layout = BlockLayout::new(&world.dimensions);
    let mut numbers = vec![0.0; layout.len];
    let spec = RolloutSpec { seed, iteration, shard, policy };
    rollout(world, &spec, &mut numbers, &mut |_| {}).map_err(|error| error.to_string())?;
    let (n_envs, n_steps) = (world.dimensions.n_envs, world.dimensions.n_steps);
    let of_agents = numbers[layout.reward].chunks_exact(n_steps * n_envs);
    let sum = |rewards: &[f32]| rewards.iter().map(|&reward| f64::from(reward)).sum::<f64>();
    let made = Made {
        seed,
        digest: Digest::of_block(&numbers),
        env_steps: world.block_env_steps(),
        returns: of_agents.map(|rewards| sum(rewards) / n_envs as f64).collect(),
    };
    serde_json::to_string(&made).map_err(|error| error.to_string())
}
