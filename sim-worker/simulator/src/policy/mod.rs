//! Actor inference without libtorch.
//!
//! A policy version arrives as one flat row of `f32` laid out by
//! [`ActorLayout`](proto::layout::ActorLayout). [`Policy::new`] checks it and packs it once;
//! [`Policy::mean`] then evaluates one actor's network for many environments at once, with
//! environments in lanes: activations are `[feature][environment lanes]`, weights are broadcast.
//!
//! **Environments never mix.** The value of every unit is one chain of fused multiply-adds over
//! its inputs in order, whatever the tile shape, so the result for an environment is the same bits
//! beside any other environments.
//!
//! **Shared networks.** Actors that share a network go through it together: they differ by the bias of the first layer alone, from which its sums start.
//!
//! **bfloat16** (`network.inference`). Hidden layers after the first multiply pairs of bfloat16, with the same
//! bits on every processor: what AVX-512 BF16 does in one instruction two fused multiply-adds do where there is none or it is slow, and
//! numbers so small that the instruction would flush them are rounded to zero everywhere. The first layer and the
//! head stay in f32. The policy that acts is the rounded one: log-probabilities are its own, evaluations and
//! compositions use it.

mod dense;
pub mod file;
mod inference;
mod initial;
mod pack;
mod registers;

pub use inference::Scratch;
pub use initial::initial_parameters;
pub use pack::{Policy, PolicyError};

#[cfg(test)]
pub(crate) mod tests;
