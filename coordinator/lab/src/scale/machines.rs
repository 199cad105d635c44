//! What is simulated.

use proto::config::Config;
use proto::layout::{ActorLayout, BlockLayout, Dimensions};

/// What things take. Times are in seconds of one core, unless it is said otherwise.
#[derive(Debug, Clone, PartialEq)]
pub struct Costs {
    /// Env-steps of a block.
    pub block_env_steps: f64,
    /// Bytes of a block.
    pub block_bytes: f64,
    /// Part of a block that every learner needs, however many there are: what critics see.
    pub shared_part: f64,
    /// Bytes of a policy.
    pub policy_bytes: f64,
    /// Blocks of an iteration.
    pub shards: u32,
    /// Iterations that rollouts are ahead.
    pub overlap: u32,
    /// A worker's time for a block.
    pub rollout_s: f64,
    /// One learner's time for an update, in seconds of the clock.
    pub update_s: f64,
    /// The hub's time to take a block in.
    pub hub_s: f64,
    /// A host's time to send a block.
    pub host_s: f64,
}

impl Costs {
    /// Of a configuration whose rollouts and updates make so many env-steps a second, a core and a learner.
    /// `hub` and `host` are what a gateway takes (ms of a core for a MB).
    pub fn new(
        config: &Config,
        dimensions: &Dimensions,
        rollout: f64,
        update: f64,
        [hub, host]: [f64; 2],
    ) -> Self {
        let block_env_steps = (dimensions.n_envs * dimensions.n_steps) as f64;
        let layout = BlockLayout::new(dimensions);
        let block_bytes = (4 * layout.len) as f64;
        let of_all = [&layout.state, &layout.terminated, &layout.truncated, &layout.metrics];
        let shared: usize = of_all.into_iter().map(ExactSizeIterator::len).sum();
        let megabytes = 1e-6 * block_bytes;
        Self {
            block_env_steps,
            block_bytes,
            shared_part: shared as f64 / layout.len as f64,
            policy_bytes: (4 * ActorLayout::new(config, dimensions).len) as f64,
            shards: dimensions.n_shards as u32,
            overlap: config.run.overlap as u32,
            rollout_s: block_env_steps / rollout,
            update_s: block_env_steps * dimensions.n_shards as f64 / update,
            hub_s: 1e-3 * hub * megabytes,
            host_s: 1e-3 * host * megabytes,
        }
    }
}

/// Machines, and the network between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Machines {
    /// Workers on the learner's machine. They take nothing from the learner.
    pub local_workers: u32,
    /// Hosts.
    pub hosts: u32,
    /// Workers of each.
    pub host_workers: u32,
    /// Learners, each on a machine of its own with its share of the agents.
    pub learners: u32,
    /// What the link of each machine carries, each way (bytes/s).
    pub bandwidth: f64,
    /// From one machine to another (s).
    pub delay: f64,
}
