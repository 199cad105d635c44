//! The passes of a group of networks: parameters in, outputs and gradients out.

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use super::passes::Passes;
use super::plain::PlainPasses;
use super::stack::Stack;
use super::torch::TorchPasses;
use crate::network::NetworkSpec;

/// What a pass needs beside the parameters: weights in the products' precision, and buffers.
#[derive(Debug)]
pub struct Compute {
    pub(super) stack: Stack,
    pub(super) passes: Box<dyn Passes>,
}

impl Compute {
    /// Buffers for `n_agents` of the networks `spec`, with products in `kind`.
    pub fn new(
        spec: &NetworkSpec,
        activation: Activation,
        n_agents: usize,
        kind: Kind,
        device: Device,
    ) -> Self {
        let stack = Stack::new(spec, activation, n_agents, kind, device);
        let passes: Box<dyn Passes> = match PlainPasses::new(&stack) {
            Some(plain) => Box::new(plain),
            None => Box::new(TorchPasses::new(&stack)),
        };
        Self { stack, passes }
    }

    /// Takes over the parameters `[A, P]`: folds and rounds them. Once before the passes of a step.
    pub fn load(&mut self, flat: &Tensor) {
        let Self { stack, passes } = self;
        for layer in 0..=stack.spec.hidden.len() {
            let (weight_name, bias_name) = stack.names(layer);
            let mut weight = stack.spec.view(&weight_name, flat);
            let mut bias = stack.spec.view(&bias_name, flat).unsqueeze(1);
            if let Some((gain, shift)) = stack.preceding(layer, flat) {
                bias = shift.unsqueeze(1).bmm(&weight) + bias;
                weight = gain.unsqueeze(2) * weight;
            }
            if layer == stack.spec.hidden.len() {
                stack.head.copy_(&weight.transpose(1, 2));
                passes.load_head(&stack.head);
                stack.head_bias.copy_(&bias.transpose(1, 2));
            } else {
                stack.weight[layer].copy_(&weight);
                passes.load_bias(layer, &bias);
            }
        }
    }

    /// The outputs `[A, U, B]`, in f32, for standardised inputs `x` `[A, B, in]` in the products'
    /// kind. What the backward pass needs stays in the buffers.
    pub fn forward(&mut self, x: &Tensor) -> Tensor {
        let Self { stack, passes } = self;
        let rows = x.size()[1];
        if stack.buffers.rows < rows {
            passes.reserve(stack, rows);
        }
        stack.buffers.inverse_std.clear();
        passes.forward(stack, x)
    }

    /// Adds to `gradient` `[A, P]` the folded gradients for the chunk that went through
    /// [`Self::forward`] last, given its inputs and the loss's gradient `[A, U, B]` by the outputs.
    pub fn backward(&mut self, x: &Tensor, d_output: &Tensor, gradient: &Tensor) {
        self.passes.backward(&self.stack, x, d_output, Some(gradient));
    }

    /// The gradient `[A, B, width]` by some of the inputs, for the chunk that went through
    /// [`Self::forward`] last: by the `width` columns of network i's input from `columns[i]` on.
    pub fn input_gradient(
        &mut self,
        x: &Tensor,
        d_output: &Tensor,
        columns: &[i64],
        width: i64,
    ) -> Tensor {
        let Self { stack, passes } = self;
        passes.backward(stack, x, d_output, None);
        let layers = stack.spec.hidden.len();
        let first = stack.gradient_chunk(layers - 1, x.size()[1], stack.spec.hidden[0]);
        let weight: Vec<Tensor> = columns
            .iter()
            .enumerate()
            .map(|(index, &column)| stack.weight[0].get(index as i64).narrow(0, column, width))
            .collect();
        first.bmm(&Tensor::stack(&weight, 0).transpose(1, 2)).to_kind(Kind::Float)
    }

    /// Turns the folded gradients that the passes of a step added up in `gradient` into those of
    /// the parameters `flat`. Once after the passes of a step.
    pub fn unfold(&self, flat: &Tensor, gradient: &Tensor) {
        for layer in 0..=self.stack.spec.hidden.len() {
            let Some((gain, shift)) = self.stack.preceding(layer, flat) else { continue };
            let (mut d_gain, mut d_shift) =
                self.stack.preceding(layer, gradient).expect("same parameters");
            let (weight_name, bias_name) = self.stack.names(layer);
            let weight = self.stack.spec.view(&weight_name, flat);
            let mut d_weight = self.stack.spec.view(&weight_name, gradient);
            let d_bias = self.stack.spec.view(&bias_name, gradient);
            d_gain.copy_(&(&weight * &d_weight).sum_dim_intlist(&[2i64][..], false, Kind::Float));
            d_shift.copy_(&weight.bmm(&d_bias.unsqueeze(2)).squeeze_dim(2));
            let _ = d_weight.g_mul_(&gain.unsqueeze(2));
            let _ = d_weight.g_add_(&(shift.unsqueeze(2) * d_bias.unsqueeze(1)));
        }
    }
}
