//! Forward and backward passes of stacked multi-layer perceptrons, by hand.
//!
//! All agents of a group go through one batched product a layer. The passes are written out instead
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
//! plain Rust, and the head is part of the last one (`plain.rs`, whose loops over samples are in `fused.rs`). Everything else goes the general
//! way, operation by operation of libtorch (`torch.rs`), which is also the twin that tests the other.
//!
//! **Precision.** In bf16 the operands of hidden layers' products are bfloat16, as are the activations
//! between them; parameters, sums over samples, the heads and all losses are f32. Samples go
//! through in chunks, so that activations stay in cache.
//!
//! Letters: `A` agents of the group, `B` samples of a chunk, `H` width of a layer, `U` outputs.

mod compute;
mod fused;
mod passes;
mod plain;
mod stack;
mod torch;

pub use compute::Compute;

#[cfg(test)]
mod tests;
