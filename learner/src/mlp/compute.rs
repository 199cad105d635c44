//! The passes of a group of networks: parameters in, outputs and gradients out.

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use super::passes::{Passes, StepGradient};
use super::plain::PlainPasses;
use super::stack::Stack;
use super::torch::TorchPasses;
use crate::network::NetworkSpec;
use crate::product::Native;

/// What a pass needs beside the parameters: weights in the products' precision, and buffers.
#[derive(Debug)]
pub struct Compute {
    pub(super) stack: Stack,
    pub(super) passes: Box<dyn Passes>,
    /// No chunk went back since the parameters were taken over.
    is_first: bool,
}

/// How many threads compute the passes of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Threads {
    /// One, which multiplies bfloat16 without libtorch if the processor has instructions for it. The bits are not those of several.
    One,
    /// As many as libtorch may use.
    Several,
}

impl Compute {
    /// Buffers for the networks `spec`, with products in `kind`.
    pub fn new(
        spec: &NetworkSpec,
        activation: Activation,
        kind: Kind,
        device: Device,
        threads: Threads,
    ) -> Self {
        let stack = Stack::new(spec, activation, kind, device);
        let own = threads == Threads::One && kind == Kind::BFloat16;
        let native = if own { Native::detect() } else { None };
        let passes: Box<dyn Passes> = match PlainPasses::new(&stack, native) {
            Some(plain) => Box::new(plain),
            None => Box::new(TorchPasses::new(&stack)),
        };
        Self { stack, passes, is_first: true }
    }

    /// Takes over the parameters `[A, P]`: folds and rounds them. Once before the passes of a step, whose first [`Self::backward`] overwrites the
    /// gradient.
    pub fn load(&mut self, flat: &Tensor) {
        self.is_first = true;
        let Self { stack, passes, .. } = self;
        for layer in 0..=stack.spec.hidden.len() {
            let preceding = stack.preceding(layer, flat);
            if preceding.is_none() && passes.load_as_it_is(stack, layer, flat) {
                continue;
            }
            let (weight_name, bias_name) = stack.names(layer);
            let mut weight = stack.spec.learned(&weight_name, flat);
            let mut bias = stack.spec.learned(&bias_name, flat).unsqueeze(1);
            if let Some((gain, shift)) = preceding {
                let shifted = shift.unsqueeze(1).bmm(&weight);
                bias = shifted.repeat([bias.size()[0] / shifted.size()[0], 1, 1]) + bias;
                weight = gain.unsqueeze(2) * weight;
            }
            if layer == stack.spec.hidden.len() {
                stack.head.copy_(&weight.transpose(1, 2));
                passes.load_head(&stack.head);
                stack.head_bias.copy_(&bias.transpose(1, 2));
            } else {
                passes.load_weight(layer, &weight, &mut stack.weight[layer]);
                passes.load_bias(layer, &bias);
            }
        }
    }

    /// `rows` `[B, A·F]`, sample by sample what all actors see, as the networks' inputs `[N, R, F]`.
    pub fn by_network(&self, rows: &Tensor) -> Tensor {
        let spec = &self.stack.spec;
        let (networks, each) = (spec.n_networks as i64, spec.rows_per_network());
        rows.view([rows.size()[0] * each, networks, -1]).transpose(0, 1)
    }

    /// `rows` `[B, F]`, which all actors see, likewise.
    pub fn for_all(&self, rows: &Tensor) -> Tensor {
        let spec = &self.stack.spec;
        let (networks, each) = (spec.n_networks as i64, spec.rows_per_network());
        let (b, f) = rows.size2().expect("[B, F]");
        let rows = match each {
            1 => rows.shallow_clone(),
            _ => rows.unsqueeze(1).expand([b, each, f], true).reshape([b * each, f]),
        };
        let rows = rows.unsqueeze(0).expand([networks, b * each, f], true);
        // On a CPU both of libtorch's products with it would copy it otherwise.
        let is_copied = rows.device() == Device::Cpu && !self.passes.share_input();
        if is_copied { rows.contiguous() } else { rows }
    }

    /// The outputs `[A, U, B]`, in f32, for standardised inputs `x` `[N, R, in]` in the products'
    /// kind. What the backward pass needs stays in the buffers.
    pub fn forward(&mut self, x: &Tensor) -> Tensor {
        let Self { stack, passes, .. } = self;
        let rows = x.size()[1];
        if stack.buffers.rows < rows {
            passes.reserve(stack, rows);
        }
        stack.cut(rows);
        stack.buffers.inverse_std.clear();
        passes.forward(stack, x)
    }

    /// Writes the folded gradients for the chunk that went through [`Self::forward`] last, given its inputs and the loss's gradient `[A, U, B]` by
    /// the outputs, where `gradient` `[A, P]` is learned, as sums over a network's actors. Further chunks of a step add theirs.
    pub fn backward(&mut self, x: &Tensor, d_output: &Tensor, gradient: &Tensor) {
        let step = StepGradient { gradient, is_first: self.is_first };
        self.passes.backward(&self.stack, x, d_output, Some(step));
        self.is_first = false;
    }

    /// The gradient `[A, B, width]` by some of the inputs, for the chunk that went through
    /// [`Self::forward`] last: by the `width` columns of actor i's input from `columns[i]` on.
    pub fn input_gradient(
        &mut self,
        x: &Tensor,
        d_output: &Tensor,
        columns: &[i64],
        width: i64,
    ) -> Tensor {
        let Self { stack, passes, .. } = self;
        passes.backward(stack, x, d_output, None);
        let first = stack.rows_by_actor(&stack.gradient(0));
        let networks = stack.spec.n_networks as i64;
        let weight_of = |actor: usize| stack.weight[0].get(actor as i64 % networks);
        let weight: Vec<Tensor> = columns
            .iter()
            .enumerate()
            .map(|(actor, &column)| weight_of(actor).narrow(0, column, width))
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
            let weight = self.stack.spec.learned(&weight_name, flat);
            let mut d_weight = self.stack.spec.learned(&weight_name, gradient);
            let d_bias = self.stack.spec.learned(&bias_name, gradient);
            // The first bias is an actor's own, what it is folded with its network's.
            let d_bias = d_bias.view([-1, weight.size()[0], weight.size()[2]]);
            let d_bias = d_bias.sum_dim_intlist(&[0i64][..], false, Kind::Float);
            d_gain.copy_(&(&weight * &d_weight).sum_dim_intlist(&[2i64][..], false, Kind::Float));
            d_shift.copy_(&weight.bmm(&d_bias.unsqueeze(2)).squeeze_dim(2));
            let _ = d_weight.g_mul_(&gain.unsqueeze(2));
            let _ = d_weight.g_add_(&(shift.unsqueeze(2) * d_bias.unsqueeze(1)));
        }
    }
}
