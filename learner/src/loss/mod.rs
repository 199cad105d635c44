//! The losses of PPO and their gradients.
//!
//! Schulman, Wolski, Dhariwal, Radford and Klimov, "Proximal policy optimization algorithms", 2017,
//! equation 7 (clipped surrogate); Ye et al., "Mastering complex control in MOBA games with deep
//! reinforcement learning", AAAI 2020, equation 5 (dual clip); Yu et al. 2022, section 5 (clipped Huber value loss). The
//! gradients by the networks' outputs are written out: each is a few products of what the loss
//! needs anyway. All losses are means over a mini-batch, for each agent by itself; chunks of a
//! mini-batch add up, so every function takes the size of the whole.
//!
//! **Two implementations.** On a CPU a loss is a few passes over the samples in plain Rust (`actor_passes.rs`, `critic_pass.rs`). On a GPU it goes
//! operation by operation of libtorch (`operations.rs`), which is also the twin that tests the other: the bits are the same.
//!
//! Letters: `A` agents, `U` actions of an agent, `B` samples of a chunk.
//!
//! Agents have as many actions as the one with most joints. `own`, `[A, U]`, is one where an action moves a joint and zero where it moves nothing: what such an
//! action is has no probability and no gradient. Nothing is given where all actions move a joint.

mod actor_passes;
mod critic_pass;
mod operations;

pub(crate) use actor_passes::{ActorRoom, STATISTICS};
pub(crate) use critic_pass::CriticRoom;
pub use operations::{ActorGradient, ActorLoss, ActorSamples, CriticLoss, CriticSamples};
