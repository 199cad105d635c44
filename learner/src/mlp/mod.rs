//! Forward and backward passes of stacked multi-layer perceptrons, by hand.
//!
//! All networks of a group go through one batched product a layer, each with the samples of all its actors. The passes are written out instead
//! of recorded by automatic differentiation: an MLP's are short, need no graph, and write into
//! buffers that are allocated once. A twin with libtorch's own differentiation tests them.
//!
//! **Folded affine maps.** A LayerNorm ends in ĥ ⊙ g + s, and the next layer begins with a product:
//! (ĥ ⊙ g + s) W + b = ĥ (g ⊙ W) + (s W + b). So the passes only standardise, with weights
//! W′ = g ⊙ W and b′ = s W + b made once a step ([`Compute::load`]), and the gradients of W′ and b′
//! become those of g, s and W once a step ([`Compute::unfold`]): dW = g ⊙ dW′ + s ⊗ db′,
//! dg = Σ_out W ⊙ dW′, ds = W db′. No affine map runs over samples.
//!
//! **Two implementations** of one trait (`passes.rs`). On a CPU with ReLU or ELU, what stands between two products is one pass over the samples in
//! plain Rust, and the head is part of the last one (`plain.rs`, whose loops over samples are in `rows.rs`); products in bf16 are our own where one
//! thread computes, if the processor has instructions for them (`products.rs`); without a LayerNorm those do all of that pass but the head. Everything else goes the general
//! way, operation by operation of libtorch (`torch.rs`), which is also the twin that tests the other.
//!
//! **Precision.** In bf16 the operands of hidden layers' products are bfloat16, as are the activations
//! between them; parameters, sums over samples, the heads and all losses are f32. Samples go
//! through in chunks, so that activations stay in cache.
//!
//! **Shared networks.** Actors of one network differ by the bias of the first hidden layer alone. So a sample of an actor is a row of its
//! network's products, and weights are rounded, packed and summed over once for all its actors. Rows stand sample by sample, then actor by actor, as
//! samples are gathered: nothing moves. Outputs and their gradients are by actor, as the losses are.
//!
//! Letters: `N` networks of the group, `K` actors of a network, `A = K·N` actors (or critics), actor k·N + n being the k-th of network n, `B` samples of a chunk,
//! `R = B·K` rows of a network, `H` width of a layer, `U` outputs.

mod compute;
mod passes;
mod plain;
mod products;
mod rounding;
mod rows;
mod stack;
mod torch;

pub use compute::{Compute, Threads};

#[cfg(test)]
mod tests;
