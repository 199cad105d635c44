//! The update: what a learner makes of an iteration's samples.
//!
//! Yu et al. 2022, algorithm 1, with separate networks for every agent (or some that several share, or
//! one that acts for all), in this order:
//!
//! 1. inputs are normalised as the policy that acted saw them (with `run.overlap` as the one after it does: a policy is one update older there), and
//!    gathered sample by sample;
//! 2. critics predict values; advantages by [`gae`](crate::gae) on denormalised values;
//! 3. each epoch first updates the value normaliser with the returns, then splits a permutation of
//!    the samples into mini-batches; each is one Adam step for actors, then one for critics;
//! 4. input normalisers take in the iteration's samples.
//!
//! **Threads.** Actors with networks of their own have nothing in common, so on a CPU each is a group
//! of its own, whose parameters, moments and gradients stay in a core's cache for the whole update;
//! threads take one group after another. What an actor learns does not depend on who computes it, nor
//! on the number of threads, up to one a group. The actors of a shared network are one group; within a
//! group all actors go through each operation together, and libtorch spreads its operations, above all the products, over the
//! threads that have no group of their own. On a GPU all networks are one group. For one number of threads the result is always the same to the
//! bit.
//!
//! **Agents and actors.** Blocks are written by agent; networks belong to actors (see
//! [`proto::layout`]), which mostly are the same. Centralised PPO has one actor for all agents: it sees
//! their observations one after the other, its action is all of theirs, the density of which is the
//! product of theirs, and it is paid the sum of their rewards. That is settled where samples are
//! gathered; nothing after it knows of agents.
//!
//! **Two ways.** On a GPU inputs and the gradients of a mini-batch go operation by operation through libtorch (`gradients.rs`). On a CPU, where an operation
//! costs more than what it computes, inputs are normalised (`inputs.rs`), samples gathered and losses taken (`plain.rs`) in plain Rust, with the same bits.
//!
//! **Copies.** The first operation that reads a block is the normalisation (of observations) or the
//! packing of what the loss needs into one row a sample; blocks are not copied before.
//!
//! Letters: `A` actors of a group, `G` agents of an actor, `T` steps, `E` environments of all shards,
//! `M = T·E` samples, `O` what an actor sees, `S` critic state, `U` actions of an actor, `B` samples of a
//! chunk.

mod epochs;
mod gradients;
mod group;
mod inputs;
mod options;
mod plain;
mod room;
mod samples;
mod trace;
mod update;

pub use trace::MappoTrace;
pub use update::Mappo;

#[cfg(test)]
mod tests;
