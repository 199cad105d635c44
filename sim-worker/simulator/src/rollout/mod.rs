//! The rollout: a pure function from a run's seed, an iteration, a shard and a policy to a block.
//!
//! Nothing outlives a call, so any worker can make any block, twice if need be, with the same bits.
//! Goals and exploration noise are drawn by address (see [`proto::rng`]), from the environment's
//! **global** index shard · N + n, and environments never mix in the arithmetic: the rows of an
//! environment are the same bits in whatever shard, lane or process it is rolled out.
//!
//! **Episodes never cross blocks.** The released code resets every 512 steps across rollouts of 50. Here every
//! rollout is whole episodes, so a worker needs no memory between two orders.

mod batch;
pub(crate) mod conditions;
pub(crate) mod environments;
mod erring;
mod error;
mod explore;
mod extremes;
mod lane_group;
mod output;
mod randomization;
mod rollout_loop;
mod running;
mod shard;
mod start;
mod world;

pub use batch::Stage;
pub use erring::Erring;
pub use error::RolloutError;
pub(crate) use output::write_rows;
#[cfg(test)]
pub(crate) use shard::rollout_with;
pub use shard::{RolloutSpec, rollout, rollout_on};
pub use world::World;

#[cfg(test)]
mod tests;
