//! The robot, its dynamics and tasks, and the worker process that rolls out policies.

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors, see `scalar`"
)]
#![expect(
    clippy::needless_range_loop,
    reason = "an index that runs through several arrays at once says more than nested zips"
)]

pub mod policy;
pub mod scalar;
pub mod task;
pub mod spatial;
pub mod robot;
pub mod state;
pub mod dynamics;
pub mod collision;
pub mod simulate;
pub mod env;
pub mod evaluate;
pub mod rollout;
pub mod worker;
