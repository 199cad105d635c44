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
//! **Fused passes.** On a CPU with ReLU or ELU, what stands between two products is one pass over the samples, and the head is part of the last
//! one (`fused.rs`). Everything else goes the general way, operation by operation.
//!
//! **Precision.** In bf16 the operands of hidden layers' products are bfloat16, as are the activations
//! between them; parameters, sums over samples, the heads and all losses are f32. Samples go
//! through in chunks, so that activations stay in cache.
//!
//! Letters: `A` agents of the group, `B` samples of a chunk, `H` width of a layer, `U` outputs.

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use crate::fused::{
    Backward, Bf16, Forward, HeadBackward, HeadForward, Number, Passes, Sizes, Unit,
};
use crate::memory::{Element, are_apart, numbers, numbers_mut};
use crate::network::NetworkSpec;

/// ε of LayerNorm.
pub const LAYER_NORM_EPSILON: f64 = 1e-5;

/// What a pass needs beside the parameters: weights in the products' precision, and buffers.
#[derive(Debug)]
pub struct Compute {
    spec: NetworkSpec,
    activation: Activation,
    kind: Kind,
    n_agents: i64,
    device: Device,
    /// `[A, in, H]` of each hidden layer, folded, in `kind`.
    weight: Vec<Tensor>,
    /// `[A, 1, H]` of each hidden layer, folded, in `kind`.
    bias: Vec<Tensor>,
    /// `[A, U, H]` and its copy in `kind`: the head, transposed, folded.
    head: Tensor,
    head_low: Tensor,
    /// `[A, U, 1]`.
    head_bias: Tensor,
    fused: Option<Fused>,
    buffers: Buffers,
}

/// What the fused passes need beside the weights.
#[derive(Debug)]
struct Fused {
    passes: Passes,
    /// `[A, H]` of each hidden layer, folded.
    bias: Vec<Tensor>,
}

/// Flat memory for the largest chunk; chunks view its beginning.
#[derive(Debug, Default)]
struct Buffers {
    rows: i64,
    /// After the activation, of each layer.
    active: Vec<Tensor>,
    /// After the standardisation, of each layer; empty without LayerNorm. With the fused passes `active` is before, and this after the activation.
    standard: Vec<Tensor>,
    /// Reciprocal deviations `[A, B, 1]` of the last pass.
    inverse_std: Vec<Tensor>,
    /// The last hidden layer in f32, if `kind` is another.
    last: Option<Tensor>,
    /// Gradients, alternating.
    gradient: [Option<Tensor>; 2],
    /// Weight gradients of each layer in `kind`.
    weight_gradient: Vec<Tensor>,
    scratch: Option<Tensor>,
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
        let a = n_agents as i64;
        let zeros = |shape: &[i64], kind| Tensor::zeros(shape, (kind, device));
        let mut weight = Vec::new();
        let mut bias = Vec::new();
        let mut width = spec.input;
        for &units in &spec.hidden {
            weight.push(zeros(&[a, width, units], kind));
            bias.push(zeros(&[a, 1, units], kind));
            width = units;
        }
        let weight_gradient = weight.iter().map(Tensor::zeros_like).collect();
        let unit = match activation {
            Activation::Relu => Some(Unit::Relu),
            Activation::Elu => Some(Unit::Elu),
            Activation::Tanh => None,
        };
        let fused = unit.filter(|_| device == Device::Cpu).map(|unit| Fused {
            passes: Passes::new(unit),
            bias: spec.hidden.iter().map(|&units| zeros(&[a, units], Kind::Float)).collect(),
        });
        Self {
            spec: spec.clone(),
            activation,
            kind,
            n_agents: a,
            device,
            weight,
            bias,
            head: zeros(&[a, spec.output, width], Kind::Float),
            head_low: zeros(&[a, spec.output, width], kind),
            head_bias: zeros(&[a, spec.output, 1], Kind::Float),
            fused,
            buffers: Buffers { weight_gradient, ..Buffers::default() },
        }
    }

    /// The gain and shift that precede hidden layer `layer` (or the head, for the last index).
    fn preceding(&self, layer: usize, flat: &Tensor) -> Option<(Tensor, Tensor)> {
        let names = match layer {
            0 if self.spec.input_layer_norm => ("input.gain".to_owned(), "input.bias".to_owned()),
            0 => return None,
            _ if self.spec.layer_norm => {
                (format!("hidden.{}.gain", layer - 1), format!("hidden.{}.shift", layer - 1))
            }
            _ => return None,
        };
        Some((self.spec.view(&names.0, flat), self.spec.view(&names.1, flat)))
    }

    /// Names of the weight and bias of hidden layer `layer`, or of the head for the last index.
    fn names(&self, layer: usize) -> (String, String) {
        if layer == self.spec.hidden.len() {
            ("head.weight".to_owned(), "head.bias".to_owned())
        } else {
            (format!("hidden.{layer}.weight"), format!("hidden.{layer}.bias"))
        }
    }

    /// Takes over the parameters `[A, P]`: folds and rounds them. Once before the passes of a step.
    pub fn load(&mut self, flat: &Tensor) {
        for layer in 0..=self.spec.hidden.len() {
            let (weight_name, bias_name) = self.names(layer);
            let mut weight = self.spec.view(&weight_name, flat);
            let mut bias = self.spec.view(&bias_name, flat).unsqueeze(1);
            if let Some((gain, shift)) = self.preceding(layer, flat) {
                bias = shift.unsqueeze(1).bmm(&weight) + bias;
                weight = gain.unsqueeze(2) * weight;
            }
            if layer == self.spec.hidden.len() {
                self.head.copy_(&weight.transpose(1, 2));
                self.head_low.copy_(&self.head);
                self.head_bias.copy_(&bias.transpose(1, 2));
            } else {
                self.weight[layer].copy_(&weight);
                match &mut self.fused {
                    Some(fused) => fused.bias[layer].copy_(&bias.squeeze_dim(1)),
                    None => self.bias[layer].copy_(&bias),
                }
            }
        }
    }

    fn reserve(&mut self, rows: i64) {
        if self.buffers.rows >= rows {
            return;
        }
        let (a, kind, device) = (self.n_agents, self.kind, self.device);
        let flat = |width: i64, kind| Tensor::zeros([a * rows * width], (kind, device));
        let widest = self.spec.hidden.iter().copied().max().unwrap_or(1);
        let layers = |kind| self.spec.hidden.iter().map(|&h| flat(h, kind)).collect::<Vec<_>>();
        self.buffers.active = layers(kind);
        if self.spec.layer_norm || self.fused.is_some() {
            self.buffers.standard = layers(kind);
        }
        let last_width = self.spec.hidden.last().copied().unwrap_or(1);
        if self.fused.is_none() {
            self.buffers.scratch = self.spec.layer_norm.then(|| flat(widest, kind));
            self.buffers.last = (kind != Kind::Float).then(|| flat(last_width, Kind::Float));
        }
        self.buffers.gradient = [Some(flat(widest, kind)), Some(flat(widest, kind))];
        self.buffers.rows = rows;
    }

    /// `[A, B, width]` at the beginning of a flat buffer.
    fn chunk(&self, flat: &Tensor, rows: i64, width: i64) -> Tensor {
        flat.narrow(0, 0, self.n_agents * rows * width).view([self.n_agents, rows, width])
    }

    /// One of the two buffers between which the gradient by activations alternates.
    fn gradient_chunk(&self, index: usize, rows: i64, width: i64) -> Tensor {
        let flat = self.buffers.gradient[index % 2].as_ref().expect("reserved by forward");
        self.chunk(flat, rows, width)
    }

    /// The outputs `[A, U, B]`, in f32, for standardised inputs `x` `[A, B, in]` in the products'
    /// kind. What the backward pass needs stays in the buffers.
    pub fn forward(&mut self, x: &Tensor) -> Tensor {
        let rows = x.size()[1];
        self.reserve(rows);
        self.buffers.inverse_std.clear();
        if self.fused.is_some() {
            return match self.kind {
                Kind::BFloat16 => self.forward_fused::<Bf16>(x),
                _ => self.forward_fused::<f32>(x),
            };
        }
        let mut input = x.shallow_clone();
        for layer in 0..self.spec.hidden.len() {
            let width = self.spec.hidden[layer];
            let mut active = self.chunk(&self.buffers.active[layer], rows, width);
            let _ = self.bias[layer].baddbmm_out(&active, &input, &self.weight[layer]);
            let _ = match self.activation {
                Activation::Relu => active.relu_(),
                Activation::Elu => active.elu_(),
                Activation::Tanh => active.tanh_(),
            };
            input = if self.spec.layer_norm {
                let standard = self.chunk(&self.buffers.standard[layer], rows, width);
                let inverse_std = standardise(&active, &standard);
                self.buffers.inverse_std.push(inverse_std);
                standard
            } else {
                active
            };
        }
        let last = self.last_hidden(&input, rows);
        self.head.bmm(&last.transpose(1, 2)) + &self.head_bias
    }

    /// Sizes of hidden layer `layer`'s arrays.
    fn sizes(&self, layer: usize, rows: i64) -> Sizes {
        Sizes {
            agents: self.n_agents as usize,
            samples: rows as usize,
            features: self.spec.hidden[layer] as usize,
            outputs: self.spec.output as usize,
        }
    }

    /// [`Self::forward`] with one pass a layer.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn forward_fused<T: Number + Element>(&mut self, x: &Tensor) -> Tensor {
        let (a, rows, layers) = (self.n_agents, x.size()[1], self.spec.hidden.len());
        let float = (Kind::Float, self.device);
        let mut output = Tensor::zeros([a, self.spec.output, rows], float);
        let mut input = x.shallow_clone();
        for layer in 0..layers {
            let width = self.spec.hidden[layer];
            let product = self.chunk(&self.buffers.active[layer], rows, width);
            let mut hidden = self.chunk(&self.buffers.standard[layer], rows, width);
            let _ = input.bmm_out(&product, &self.weight[layer]);
            let mut inverse_std = self.spec.layer_norm.then(|| Tensor::zeros([a, rows], float));
            let sizes = self.sizes(layer, rows);
            let fused = self.fused.as_mut().expect("asked before");
            // SAFETY: every tensor here was made of zeros by this type or this call and has a storage of
            // its own: `active` and `standard` of this layer are two buffers. No handle of them has left
            // it, and libtorch does nothing until the pass has ended.
            let arrays = unsafe {
                Forward {
                    product: numbers(&product),
                    bias: numbers(&fused.bias[layer]),
                    hidden: numbers_mut(&mut hidden),
                    inverse_std: inverse_std.as_mut().map(|tensor| numbers_mut(tensor)),
                    head: (layer + 1 == layers).then(|| HeadForward {
                        weight: numbers(&self.head),
                        bias: numbers(&self.head_bias),
                        output: numbers_mut(&mut output),
                    }),
                }
            };
            fused.passes.forward::<T>(sizes, arrays);
            self.buffers.inverse_std.extend(inverse_std);
            input = hidden;
        }
        output
    }

    /// [`Self::backward`] with one pass a layer.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn backward_fused<T: Number + Element>(
        &mut self,
        x: &Tensor,
        d_output: &Tensor,
        gradient: Option<&Tensor>,
    ) {
        let (a, rows, layers) = (self.n_agents, x.size()[1], self.spec.hidden.len());
        let float = (Kind::Float, self.device);
        let add = |name: &str, part: &Tensor, gradient: &Tensor| {
            let _ = self.spec.view(name, gradient).g_add_(part);
        };
        let d_output = d_output.contiguous();
        for layer in (0..layers).rev() {
            let width = self.spec.hidden[layer];
            let mut d = self.gradient_chunk(layers - 1 - layer, rows, width);
            let product = self.chunk(&self.buffers.active[layer], rows, width);
            let hidden = self.chunk(&self.buffers.standard[layer], rows, width);
            let mut d_bias = Tensor::zeros([a, width], float);
            let mut d_head = Tensor::zeros([a, self.spec.output, width], float);
            let mut d_head_bias = Tensor::zeros([a, self.spec.output], float);
            let is_last = layer + 1 == layers;
            assert!(
                are_apart(&[&d, &d_output]),
                "the loss's gradient lies in a buffer of the passes"
            );
            let sizes = self.sizes(layer, rows);
            let fused = self.fused.as_mut().expect("asked before");
            // SAFETY: `d_output` is filled by the caller and apart from what is written. Every other
            // tensor here was made of zeros by this type or this call and has a storage of its own:
            // `active`, `standard` and `gradient` are three buffers. No handle of what is written has
            // left it, and libtorch does nothing until the pass has ended.
            let arrays = unsafe {
                Backward {
                    product: numbers(&product),
                    bias: numbers(&fused.bias[layer]),
                    hidden: numbers(&hidden),
                    inverse_std: self.buffers.inverse_std.get(layer).map(|tensor| numbers(tensor)),
                    gradient: numbers_mut(&mut d),
                    bias_gradient: numbers_mut(&mut d_bias),
                    head: is_last.then(|| HeadBackward {
                        weight: numbers(&self.head),
                        output_gradient: numbers(&d_output),
                        weight_gradient: numbers_mut(&mut d_head),
                        bias_gradient: numbers_mut(&mut d_head_bias),
                    }),
                }
            };
            fused.passes.backward::<T>(sizes, arrays);
            if let Some(gradient) = gradient {
                if is_last {
                    add("head.weight", &d_head.transpose(1, 2), gradient);
                    add("head.bias", &d_head_bias, gradient);
                }
                let input = if layer == 0 {
                    x.shallow_clone()
                } else {
                    self.chunk(&self.buffers.standard[layer - 1], rows, self.spec.hidden[layer - 1])
                };
                let part = &self.buffers.weight_gradient[layer];
                let _ = input.transpose(1, 2).bmm_out(part, &d);
                let (weight_name, bias_name) = self.names(layer);
                add(&weight_name, part, gradient);
                add(&bias_name, &d_bias, gradient);
            }
            if layer > 0 {
                let below = self.gradient_chunk(layers - layer, rows, self.spec.hidden[layer - 1]);
                let _ = d.bmm_out(&below, &self.weight[layer].transpose(1, 2));
            }
        }
    }

    /// The head's input in f32.
    fn last_hidden(&self, input: &Tensor, rows: i64) -> Tensor {
        match &self.buffers.last {
            Some(flat) => {
                let mut last = self.chunk(flat, rows, input.size()[2]);
                last.copy_(input);
                last
            }
            None => input.shallow_clone(),
        }
    }

    /// Adds to `gradient` `[A, P]` the folded gradients for the chunk that went through
    /// [`Self::forward`] last, given its inputs and the loss's gradient `[A, U, B]` by the outputs.
    pub fn backward(&mut self, x: &Tensor, d_output: &Tensor, gradient: &Tensor) {
        self.propagate(x, d_output, Some(gradient));
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
        self.propagate(x, d_output, None);
        let layers = self.spec.hidden.len();
        let first = self.gradient_chunk(layers - 1, x.size()[1], self.spec.hidden[0]);
        let weight: Vec<Tensor> = columns
            .iter()
            .enumerate()
            .map(|(index, &column)| self.weight[0].get(index as i64).narrow(0, column, width))
            .collect();
        first.bmm(&Tensor::stack(&weight, 0).transpose(1, 2)).to_kind(Kind::Float)
    }

    /// Goes backward to the first layer; what it adds up to on the way goes into `gradient`, if any.
    fn propagate(&mut self, x: &Tensor, d_output: &Tensor, gradient: Option<&Tensor>) {
        if self.fused.is_some() {
            return match self.kind {
                Kind::BFloat16 => self.backward_fused::<Bf16>(x, d_output, gradient),
                _ => self.backward_fused::<f32>(x, d_output, gradient),
            };
        }
        let rows = x.size()[1];
        let layers = self.spec.hidden.len();
        let kind = self.kind;
        let hidden = |compute: &Self, layer: usize| {
            let buffers = &compute.buffers;
            let flat = if compute.spec.layer_norm { &buffers.standard } else { &buffers.active };
            compute.chunk(&flat[layer], rows, compute.spec.hidden[layer])
        };
        let add = |name: &str, part: &Tensor, gradient: &Tensor| {
            let _ = self.spec.view(name, gradient).g_add_(part);
        };

        let width = self.spec.hidden[layers - 1];
        let last = match &self.buffers.last {
            Some(flat) => self.chunk(flat, rows, width),
            None => hidden(self, layers - 1),
        };
        if let Some(gradient) = gradient {
            add("head.weight", &d_output.bmm(&last).transpose(1, 2), gradient);
            let d_bias = d_output.sum_dim_intlist(&[2i64][..], false, Kind::Float);
            add("head.bias", &d_bias, gradient);
        }

        let mut d_hidden = self.gradient_chunk(0, rows, width);
        let d_low = d_output.transpose(1, 2).to_kind(kind);
        if kind == Kind::Float && self.spec.output == 1 {
            // One column: a broadcast product is far faster than a matrix product.
            let _ = d_low.multiply_out(&d_hidden, &self.head_low);
        } else {
            let _ = d_low.bmm_out(&d_hidden, &self.head_low);
        }

        for layer in (0..layers).rev() {
            let width = self.spec.hidden[layer];
            let active = self.chunk(&self.buffers.active[layer], rows, width);
            if self.spec.layer_norm {
                let scratch = self.buffers.scratch.as_ref().expect("reserved by forward");
                let scratch = self.chunk(scratch, rows, width);
                let standard = hidden(self, layer);
                let inverse_std = &self.buffers.inverse_std[layer];
                standardise_backward(&mut d_hidden, &standard, inverse_std, &scratch);
            }
            let d = &d_hidden;
            let _ = match self.activation {
                Activation::Relu => active.threshold_backward_grad_input(d, d, 0.0),
                Activation::Elu => {
                    Tensor::elu_backward_grad_input(d, d, 1.0, 1.0, 1.0, true, &active)
                }
                Activation::Tanh => Tensor::tanh_backward_grad_input(d, d, &active),
            };
            if let Some(gradient) = gradient {
                let input = if layer == 0 { x.shallow_clone() } else { hidden(self, layer - 1) };
                let part = &self.buffers.weight_gradient[layer];
                let _ = input.transpose(1, 2).bmm_out(part, d);
                let (weight_name, bias_name) = self.names(layer);
                add(&weight_name, part, gradient);
                let d_bias = d.sum_dim_intlist(&[1i64][..], false, Kind::Float);
                add(&bias_name, &d_bias, gradient);
            }
            if layer > 0 {
                let below = self.gradient_chunk(layers - layer, rows, self.spec.hidden[layer - 1]);
                let _ = d_hidden.bmm_out(&below, &self.weight[layer].transpose(1, 2));
                d_hidden = below;
            }
        }
    }

    /// Turns the folded gradients that the passes of a step added up in `gradient` into those of
    /// the parameters `flat`. Once after the passes of a step.
    pub fn unfold(&self, flat: &Tensor, gradient: &Tensor) {
        for layer in 0..=self.spec.hidden.len() {
            let Some((gain, shift)) = self.preceding(layer, flat) else { continue };
            let (mut d_gain, mut d_shift) =
                self.preceding(layer, gradient).expect("same parameters");
            let (weight_name, bias_name) = self.names(layer);
            let weight = self.spec.view(&weight_name, flat);
            let mut d_weight = self.spec.view(&weight_name, gradient);
            let d_bias = self.spec.view(&bias_name, gradient);
            d_gain.copy_(&(&weight * &d_weight).sum_dim_intlist(&[2i64][..], false, Kind::Float));
            d_shift.copy_(&weight.bmm(&d_bias.unsqueeze(2)).squeeze_dim(2));
            let _ = d_weight.g_mul_(&gain.unsqueeze(2));
            let _ = d_weight.g_add_(&(shift.unsqueeze(2) * d_bias.unsqueeze(1)));
        }
    }
}

/// Standardises each sample of `x` `[A, B, H]` over its features into `out`; returns the
/// reciprocal deviations `[A, B, 1]`.
fn standardise(x: &Tensor, out: &Tensor) -> Tensor {
    let (a, b, h) = x.size3().expect("[A, B, H]");
    let options = (Kind::Float, x.device());
    let mean = Tensor::empty([a, b, 1], options);
    let inverse_std = Tensor::empty([a, b, 1], options);
    // With an f32 gain libtorch keeps the moments of bf16 input in f32.
    let gain = Tensor::ones([h], options);
    let bias = Tensor::zeros([h], options);
    let _ = x.native_layer_norm_out(
        out,
        &mean,
        &inverse_std,
        [h],
        Some(gain),
        Some(bias),
        LAYER_NORM_EPSILON,
    );
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

/// Standardises each input over its features, without gain: what a LayerNorm input becomes before
/// its folded affine map. `x` is `[…, in]` in f32.
pub fn standardise_input(x: &Tensor) -> Tensor {
    let width = x.size()[x.dim() - 1];
    x.layer_norm([width], None::<Tensor>, None::<Tensor>, LAYER_NORM_EPSILON, false)
}

#[cfg(test)]
mod tests;
