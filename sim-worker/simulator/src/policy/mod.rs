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

mod dense;
mod inference;
mod initial;
mod pack;

pub use inference::Scratch;
pub use initial::initial_parameters;
pub use pack::{Policy, PolicyError};

#[cfg(test)]
pub(crate) mod tests;
