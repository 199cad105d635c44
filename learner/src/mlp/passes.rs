//! What an implementation of the passes does.

use std::fmt::Debug;

use tch::Tensor;

use super::stack::Stack;

/// The way forward and back through the folded layers of a [`Stack`].
pub(super) trait Passes: Debug + Send {
    /// Takes over the folded bias `[A, 1, H]` of a hidden layer.
    fn load_bias(&mut self, layer: usize, bias: &Tensor);

    /// Takes over the folded head `[A, U, H]`.
    fn load_head(&mut self, head: &Tensor);

    /// Gets memory for chunks of `rows` samples.
    fn reserve(&mut self, stack: &mut Stack, rows: i64);

    /// The outputs `[A, U, B]`, in f32, for standardised inputs `x` `[A, B, in]` in the products' kind. What the way back needs
    /// stays in the buffers.
    fn forward(&mut self, stack: &mut Stack, x: &Tensor) -> Tensor;

    /// Goes back to the first layer from the loss's gradient `[A, U, B]` by the outputs; what the folded parameters' gradients add up to on the
    /// way goes into `gradient` `[A, P]`, if any.
    fn backward(&mut self, stack: &Stack, x: &Tensor, d_output: &Tensor, gradient: Option<&Tensor>);
}
