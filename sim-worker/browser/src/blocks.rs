//! A block of a run, made again: what a worker sent to the learner, from its address alone.

use proto::Digest;
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
    /// A text: a number of the page's language does not hold all seeds.
    seed: String,
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
    let mut numbers = vec![0.0; world.block_layout().len];
    let spec = RolloutSpec { seed, iteration, shard, policy };
    rollout(world, &spec, &mut numbers, &mut |_| {}).map_err(|error| error.to_string())?;
    let made = Made {
        seed: seed.to_string(),
        digest: Digest::of_block(&numbers),
        env_steps: world.block_env_steps(),
        returns: world.mean_returns(&numbers),
    };
    serde_json::to_string(&made).map_err(|error| error.to_string())
}
