//! Why there is no block.

use crate::env::EpisodeError;

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
