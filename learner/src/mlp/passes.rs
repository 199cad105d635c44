//! What an implementation of the passes does.

use std::fmt::Debug;

use tch::Tensor;

use super::stack::Stack;
use crate::network::NetworkSpec;

/// The way forward and back through the folded layers of a [`Stack`].
pub(super) trait Passes: Debug + Send {
    /// Whether an input that all networks share may lie in memory once.
    fn share_input(&self) -> bool {
        false
    }

    /// Takes over a layer of parameters `[A, P]` that nothing is folded into, if that can be done without tensors of its parts.
    fn load_as_it_is(&mut self, _stack: &mut Stack, _layer: usize, _flat: &Tensor) -> bool {
        false
    }

    /// Takes over the folded weights `[N, in, H]` of a hidden layer, which are rounded into the stack's.
    fn load_weight(&mut self, _layer: usize, weight: &Tensor, rounded: &mut Tensor) {
        rounded.copy_(weight);
    }

    /// Takes over the folded bias of a hidden layer, `[A, 1, H]` of the first, `[N, 1, H]` of the others.
    fn load_bias(&mut self, layer: usize, bias: &Tensor);

    /// Takes over the folded head `[N, U, H]`.
    fn load_head(&mut self, head: &Tensor);

    /// Gets memory for chunks of `rows` rows.
    fn reserve(&mut self, stack: &mut Stack, rows: i64);

    /// The outputs `[A, U, B]`, in f32, for standardised inputs `x` `[N, R, in]` in the products' kind. What the way back needs
    /// stays in the buffers.
    fn forward(&mut self, stack: &mut Stack, x: &Tensor) -> Tensor;

    /// Goes back to the first layer from the loss's gradient `[A, U, B]` by the outputs; the folded parameters' gradients, which are found on the
    /// way, go into `step`, if any.
    fn backward(
        &mut self,
        stack: &Stack,
        x: &Tensor,
        d_output: &Tensor,
        step: Option<StepGradient<'_>>,
    );
}

/// Where the gradients of a step's chunks add up.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepGradient<'a> {
    /// `[A, P]`.
    pub(super) gradient: &'a Tensor,
    /// Whether what stands there is older.
    pub(super) is_first: bool,
}

impl StepGradient<'_> {
    /// Takes in a chunk's gradient by what is learned of a parameter.
    pub(super) fn take(self, spec: &NetworkSpec, name: &str, part: &Tensor) {
        let mut sum = spec.learned(name, self.gradient);
        if self.is_first {
            sum.copy_(part);
        } else {
            let _ = sum.g_add_(part);
        }
    }
}
