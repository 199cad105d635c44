//! The passes operation by operation of libtorch: for every activation and device, and the twin that tests the plain ones.

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use super::passes::{Passes, StepGradient};
use super::stack::Stack;
use crate::layer_norm::LAYER_NORM_EPSILON;

/// Several operations a layer.
#[derive(Debug)]
pub(super) struct TorchPasses {
    /// `[A, 1, H]` of the first hidden layer, `[N, 1, H]` of the others, folded, in the products' kind.
    bias: Vec<Tensor>,
    /// `[N, U, H]`: the head in the products' kind.
    head_low: Tensor,
    /// The last hidden layer in f32, if the products' kind is another.
    last: Option<Tensor>,
    scratch: Option<Tensor>,
}

impl TorchPasses {
    /// For the layers of `stack`.
    pub(super) fn new(stack: &Stack) -> Self {
        let zeros = |shape: &[i64]| Tensor::zeros(shape, (stack.kind, stack.device));
        let hidden = stack.spec.hidden.iter().enumerate();
        Self {
            bias: hidden.map(|(layer, &units)| zeros(&[stack.biases(layer), 1, units])).collect(),
            head_low: zeros(&stack.head.size()),
            last: None,
            scratch: None,
        }
    }

    /// The head's input in f32.
    fn last_hidden(&self, stack: &Stack, input: &Tensor, rows: i64) -> Tensor {
        match &self.last {
            Some(flat) => {
                let mut last = stack.chunk(flat, rows, input.size()[2]);
                last.copy_(input);
                last
            }
            None => input.shallow_clone(),
        }
    }
}

impl Passes for TorchPasses {
    fn load_bias(&mut self, layer: usize, bias: &Tensor) {
        self.bias[layer].copy_(bias);
    }

    fn load_head(&mut self, head: &Tensor) {
        self.head_low.copy_(head);
    }

    fn reserve(&mut self, stack: &mut Stack, rows: i64) {
        let layer_norm = stack.spec.layer_norm;
        stack.reserve(rows, layer_norm);
        let last_width = stack.spec.hidden.last().copied().unwrap_or(1);
        self.scratch = layer_norm.then(|| stack.flat(rows, stack.widest(), stack.kind));
        self.last = (stack.kind != Kind::Float).then(|| stack.flat(rows, last_width, Kind::Float));
    }

    fn forward(&mut self, stack: &mut Stack, x: &Tensor) -> Tensor {
        let rows = x.size()[1];
        let mut input = x.shallow_clone();
        for layer in 0..stack.spec.hidden.len() {
            let width = stack.spec.hidden[layer];
            let mut active = stack.active(layer);
            let bias = &self.bias[layer];
            if bias.size()[0] == stack.networks() {
                let _ = bias.baddbmm_out(&active, &input, &stack.weight[layer]);
            } else {
                // [A, 1, H] is [K, N, H], which every sample's rows [N, B, K, H] take.
                let _ = input.bmm_out(&active, &stack.weight[layer]);
                let each = stack.spec.rows_per_network();
                let bias = bias.view([each, stack.networks(), 1, width]).permute([1, 2, 0, 3]);
                let _ = active.view([stack.networks(), -1, each, width]).g_add_(&bias);
            }
            let _ = match stack.activation {
                Activation::Relu => active.relu_(),
                Activation::Elu => active.elu_(),
                Activation::Tanh => active.tanh_(),
            };
            input = if stack.spec.layer_norm {
                let standard = stack.standard(layer);
                let inverse_std = standardise(&active, &standard);
                stack.buffers.inverse_std.push(inverse_std);
                standard
            } else {
                active
            };
        }
        let last = self.last_hidden(stack, &input, rows);
        let output = stack.head.bmm(&last.transpose(1, 2)) + &stack.head_bias;
        stack.rows_by_actor(&output.transpose(1, 2)).transpose(1, 2).contiguous()
    }

    fn backward(
        &mut self,
        stack: &Stack,
        x: &Tensor,
        d_output: &Tensor,
        step: Option<StepGradient<'_>>,
    ) {
        let rows = x.size()[1];
        let layers = stack.spec.hidden.len();
        let kind = stack.kind;
        let hidden = |layer: usize| {
            if stack.spec.layer_norm { stack.standard(layer) } else { stack.active(layer) }
        };
        let (networks, each) = (stack.networks(), stack.spec.rows_per_network());
        // [A, U, B] is [K, N, U, B]; rows are [N, B, K], of U numbers each.
        let d_output = d_output.view([each, networks, stack.spec.output, rows / each]);
        let d_output = d_output.permute([1, 2, 3, 0]).reshape([networks, stack.spec.output, rows]);

        let width = stack.spec.hidden[layers - 1];
        let last = match &self.last {
            Some(flat) => stack.chunk(flat, rows, width),
            None => hidden(layers - 1),
        };
        if let Some(step) = step {
            step.take(&stack.spec, "head.weight", &d_output.bmm(&last).transpose(1, 2));
            let d_bias = d_output.sum_dim_intlist(&[2i64][..], false, Kind::Float);
            step.take(&stack.spec, "head.bias", &d_bias);
        }

        let mut d_hidden = stack.gradient(layers - 1);
        let d_low = d_output.transpose(1, 2).to_kind(kind);
        if kind == Kind::Float && stack.spec.output == 1 {
            // One column: a broadcast product is far faster than a matrix product.
            let _ = d_low.multiply_out(&d_hidden, &self.head_low);
        } else {
            let _ = d_low.bmm_out(&d_hidden, &self.head_low);
        }

        for layer in (0..layers).rev() {
            let width = stack.spec.hidden[layer];
            let active = stack.active(layer);
            if stack.spec.layer_norm {
                let scratch = self.scratch.as_ref().expect("reserved by forward");
                let scratch = stack.chunk(scratch, rows, width);
                let standard = hidden(layer);
                let inverse_std = &stack.buffers.inverse_std[layer];
                standardise_backward(&mut d_hidden, &standard, inverse_std, &scratch);
            }
            let d = &d_hidden;
            let _ = match stack.activation {
                Activation::Relu => active.threshold_backward_grad_input(d, d, 0.0),
                Activation::Elu => {
                    Tensor::elu_backward_grad_input(d, d, 1.0, 1.0, 1.0, true, &active)
                }
                Activation::Tanh => Tensor::tanh_backward_grad_input(d, d, &active),
            };
            if let Some(step) = step {
                let input = if layer == 0 { x.shallow_clone() } else { hidden(layer - 1) };
                let part = &stack.buffers.weight_gradient[layer];
                let _ = input.transpose(1, 2).bmm_out(part, d);
                let (weight_name, bias_name) = stack.names(layer);
                step.take(&stack.spec, &weight_name, part);
                // Over samples; of the first layer, whose biases are the actors' own, each actor's by themselves.
                let of_bias = stack.biases(layer) / networks;
                let d_bias = d.view([networks, -1, of_bias, width]);
                let d_bias = d_bias.sum_dim_intlist(&[1i64][..], false, Kind::Float);
                let d_bias = d_bias.transpose(0, 1).reshape([-1, width]);
                step.take(&stack.spec, &bias_name, &d_bias);
            }
            if layer > 0 {
                let below = stack.gradient(layer - 1);
                let _ = d_hidden.bmm_out(&below, &stack.weight[layer].transpose(1, 2));
                d_hidden = below;
            }
        }
    }
}

/// Standardises each row of `x` `[N, R, H]` over its features into `out`; returns the
/// reciprocal deviations `[N, R, 1]`.
fn standardise(x: &Tensor, out: &Tensor) -> Tensor {
    let (n, r, h) = x.size3().expect("[N, R, H]");
    let options = (Kind::Float, x.device());
    let mean = Tensor::empty([n, r, 1], options);
    let inverse_std = Tensor::empty([n, r, 1], options);
    // On a CPU the moments of bf16 input are bf16 unless there is an f32 gain. On a GPU they are f32, and an f32 gain is refused.
    let affine = (x.device() == Device::Cpu)
        .then(|| (Tensor::ones([h], options), Tensor::zeros([h], options)));
    let (gain, bias) = affine.unzip();
    let _ = x.native_layer_norm_out(out, &mean, &inverse_std, [h], gain, bias, LAYER_NORM_EPSILON);
    inverse_std
}

/// Turns the gradient by standardised values ĥ into that by the values before, in place:
/// (d − mean(d) − ĥ · mean(d ⊙ ĥ)) / σ.
fn standardise_backward(d: &mut Tensor, standard: &Tensor, inverse_std: &Tensor, scratch: &Tensor) {
    let features = &[2i64][..];
    let _ = d.multiply_out(scratch, standard);
    let kind = d.kind();
    let along = scratch.mean_dim(features, true, Kind::Float);
    let mean = d.mean_dim(features, true, Kind::Float);
    let inverse_std = inverse_std.to_kind(kind);
    let _ = d.g_sub_(&mean.to_kind(kind));
    let _ = d.addcmul_(standard, &(-along).to_kind(kind));
    let _ = d.g_mul_(&inverse_std);
}
