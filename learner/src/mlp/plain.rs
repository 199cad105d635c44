//! The passes on a CPU with ReLU or ELU: what stands between two products (`products.rs`) is one loop over the samples in plain Rust. Products of our own go
//! through the units themselves, unless there is a LayerNorm; what is left of the loop is the head.

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use super::passes::{Passes, StepGradient};
use super::products::Products;
use super::rows::{Backward, Forward, HeadBackward, HeadForward, RowPasses, Sizes};
use super::stack::Stack;
use crate::memory::{Element, are_apart, numbers, numbers_mut};
use crate::number::{Bf16, Number};
use crate::product::Native;
use crate::unit::Unit;

/// One loop over the samples a layer.
#[derive(Debug)]
pub(super) struct PlainPasses {
    rows: RowPasses,
    products: Products,
    /// `[A, H]` of the first hidden layer, `[N, H]` of the others, folded.
    bias: Vec<Vec<f32>>,
    chunk: ChunkGradient,
}

/// Gradients of the layer at hand that are sums over a chunk's rows.
#[derive(Debug, Default)]
struct ChunkGradient {
    /// `[A, H]` or `[N, H]`.
    bias: Vec<f32>,
    /// `[N, U, H]`.
    head: Vec<f32>,
    /// `[N, U]`.
    head_bias: Vec<f32>,
}

impl PlainPasses {
    /// For the layers of `stack`, if they are of those that it can do. Products in bfloat16 are ours by `native`, or libtorch's.
    pub(super) fn new(stack: &Stack, native: Option<Native>) -> Option<Self> {
        let unit = match stack.activation {
            Activation::Relu => Unit::Relu,
            Activation::Elu => Unit::Elu,
            Activation::Tanh => return None,
        };
        let hidden = stack.spec.hidden.iter().enumerate();
        (stack.device == Device::Cpu).then(|| Self {
            rows: RowPasses::new(unit),
            products: Products::new(stack, native),
            bias: hidden
                .map(|(layer, &units)| vec![0.0; (stack.biases(layer) * units) as usize])
                .collect(),
            chunk: ChunkGradient::default(),
        })
    }

    /// [`Passes::forward`] with activations of `T`.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn forward_in<T: Number + Element>(&mut self, stack: &mut Stack, x: &Tensor) -> Tensor {
        let (rows, layers) = (x.size()[1], stack.spec.hidden.len());
        let float = (Kind::Float, stack.device);
        let spec = &stack.spec;
        let output = [spec.rows as i64, spec.output, rows / spec.rows_per_network()];
        let mut output = Tensor::zeros(output, float);
        let mut input = x.shallow_clone();
        let through_units = self.products.go_through_units(stack);
        for layer in 0..layers {
            let (mut product, mut hidden) = (stack.active(layer), stack.standard(layer));
            let is_last = layer + 1 == layers;
            if through_units {
                let units = (self.rows.unit(), self.bias[layer].as_slice());
                self.products.activations(stack, layer, units, &input, &mut hidden);
            } else {
                self.products.forward(stack, layer, &input, &mut product);
            }
            if through_units && !is_last {
                input = hidden;
                continue;
            }
            let deviations = [stack.networks(), rows];
            let mut inverse_std = stack.spec.layer_norm.then(|| Tensor::zeros(deviations, float));
            let sizes = sizes(stack, layer, rows);
            // SAFETY: every tensor here was made of zeros by this type, its stack or this call and has a
            // storage of its own: `active` and `standard` of this layer are two buffers. No handle of them
            // has left it, and libtorch does nothing until the pass has ended.
            let arrays = unsafe {
                Forward {
                    product: (!through_units).then(|| numbers(&product)),
                    bias: &self.bias[layer],
                    hidden: numbers_mut(&mut hidden),
                    inverse_std: inverse_std.as_mut().map(|tensor| numbers_mut(tensor)),
                    head: is_last.then(|| HeadForward {
                        weight: numbers(&stack.head),
                        bias: numbers(&stack.head_bias),
                        output: numbers_mut(&mut output),
                    }),
                }
            };
            self.rows.forward::<T>(sizes, arrays);
            stack.buffers.inverse_std.extend(inverse_std);
            input = hidden;
        }
        output
    }

    /// [`Passes::backward`] with activations of `T`.
    fn backward_in<T: Number + Element>(
        &mut self,
        stack: &Stack,
        x: &Tensor,
        d_output: &Tensor,
        step: Option<StepGradient<'_>>,
    ) {
        let layers = stack.spec.hidden.len();
        let d_output = d_output.contiguous();
        let through_units = self.products.go_through_units(stack);
        for layer in (0..layers).rev() {
            let mut d = stack.gradient(layer);
            // Elsewhere the product of the layer above went back through this one's units.
            if layer + 1 == layers || !through_units {
                self.back_through_units::<T>(stack, layer, &mut d, &d_output);
            }
            if let Some(step) = step {
                self.take(stack, layer, step);
                let input = if layer == 0 { x.shallow_clone() } else { stack.standard(layer - 1) };
                self.products.weight_gradient(stack, layer, [&input, &d], step);
            }
            if layer == 0 {
                break;
            }
            let mut below = stack.gradient(layer - 1);
            if through_units {
                let bias = &mut self.chunk.bias;
                zeros(bias, self.bias[layer - 1].len());
                let units = (self.rows.unit(), bias.as_mut_slice());
                let factors = [&d, &stack.standard(layer - 1)];
                self.products.gradient_below(stack, layer, units, factors, &mut below);
            } else {
                self.products.input_gradient(stack, layer, &d, &mut below);
            }
        }
    }

    /// Goes back through the units of a layer, and through the head if it is the last one: `d`, the gradient by the layer's activations, becomes
    /// that by its products.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn back_through_units<T: Number + Element>(
        &mut self,
        stack: &Stack,
        layer: usize,
        d: &mut Tensor,
        d_output: &Tensor,
    ) {
        let (width, outputs) = (stack.spec.hidden[layer] as usize, stack.spec.output as usize);
        let is_last = layer + 1 == stack.spec.hidden.len();
        let (product, hidden) = (stack.active(layer), stack.standard(layer));
        let ChunkGradient { bias, head, head_bias } = &mut self.chunk;
        zeros(bias, self.bias[layer].len());
        if is_last {
            zeros(head, stack.spec.n_networks * outputs * width);
            zeros(head_bias, stack.spec.n_networks * outputs);
        }
        assert!(are_apart(&[d, d_output]), "the loss's gradient lies in a buffer of the passes");
        let sizes = sizes(stack, layer, d.size()[1]);
        // SAFETY: `d_output` is filled by the caller and apart from what is written. Every other
        // tensor here was made of zeros by the stack, or by the pass forward, and has a storage of its own: `active`,
        // `standard` and `gradient` are three buffers. No handle of what is written has left the stack, and libtorch does
        // nothing until the pass has ended.
        let arrays = unsafe {
            Backward {
                product: numbers(&product),
                bias: &self.bias[layer],
                hidden: numbers(&hidden),
                inverse_std: stack.buffers.inverse_std.get(layer).map(|tensor| numbers(tensor)),
                gradient: numbers_mut(d),
                bias_gradient: bias,
                head: is_last.then(|| HeadBackward {
                    weight: numbers(&stack.head),
                    output_gradient: numbers(d_output),
                    weight_gradient: head,
                    bias_gradient: head_bias,
                }),
            }
        };
        self.rows.backward::<T>(sizes, arrays);
    }

    /// Takes what rows have added up to into the gradient of a step: the layer's biases, and the head if it is the last layer.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn take(&self, stack: &Stack, layer: usize, step: StepGradient<'_>) {
        let ChunkGradient { bias, head, head_bias } = &self.chunk;
        let outputs = stack.spec.output as usize;
        let mut gradient = step.gradient.shallow_clone();
        // SAFETY: the gradient is made of zeros by its owner, who lends it for this pass and reads it later. No other tensor
        // of the pass shares its memory.
        let gradient: &mut [f32] = unsafe { numbers_mut(&mut gradient) };
        let rows = gradient.chunks_exact_mut(stack.spec.len as usize);
        let take = |sum: &mut f32, part: f32| *sum = if step.is_first { part } else { *sum + part };
        let width = stack.spec.hidden[layer] as usize;
        for (network, row) in rows.enumerate() {
            if let Some(part) = bias.chunks_exact(width).nth(network) {
                let [_, columns] = &stack.columns[layer];
                row[columns.clone()].iter_mut().zip(part).for_each(|(sum, &part)| take(sum, part));
            }
            if layer + 1 < stack.spec.hidden.len() || network >= stack.spec.n_networks {
                continue;
            }
            let [weight_columns, bias_columns] = &stack.columns[layer + 1];
            let weight = row[weight_columns.clone()].chunks_exact_mut(outputs);
            let head = &head[network * outputs * width..];
            for (feature, sums) in weight.enumerate() {
                for (output, sum) in sums.iter_mut().enumerate() {
                    take(sum, head[output * width + feature]);
                }
            }
            let part = &head_bias[network * outputs..];
            let sums = row[bias_columns.clone()].iter_mut();
            sums.zip(part).for_each(|(sum, &part)| take(sum, part));
        }
    }
}

/// Room for so many zeros.
fn zeros(numbers: &mut Vec<f32>, len: usize) {
    numbers.clear();
    numbers.resize(len, 0.0);
}

impl Passes for PlainPasses {
    fn share_input(&self) -> bool {
        self.products.share_input()
    }

    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn load_as_it_is(&mut self, stack: &mut Stack, layer: usize, flat: &Tensor) -> bool {
        let (networks, biases) = (stack.spec.n_networks, stack.biases(layer) as usize);
        let [weight, bias] = stack.columns[layer].clone();
        // SAFETY: parameters are filled, and nobody writes them while they are loaded.
        let flat: &[f32] = unsafe { numbers(flat) };
        let rows = flat.chunks_exact(stack.spec.len as usize);
        let weights = rows.clone().take(networks).map(|row| &row[weight.clone()]);
        let biases = rows.take(biases).map(|row| &row[bias.clone()]);
        if layer < stack.spec.hidden.len() {
            self.products.load_as_they_are(stack, layer, weights);
            let ours = self.bias[layer].chunks_exact_mut(bias.len());
            ours.zip(biases).for_each(|(ours, bias)| ours.copy_from_slice(bias));
            return true;
        }
        // SAFETY: made of zeros by the stack, two storages apart from the parameters.
        let (head, head_bias): (&mut [f32], &mut [f32]) =
            unsafe { (numbers_mut(&mut stack.head), numbers_mut(&mut stack.head_bias)) };
        let outputs = bias.len();
        let width = weight.len() / outputs;
        for (head, weight) in head.chunks_exact_mut(weight.len()).zip(weights) {
            for (output, head) in head.chunks_exact_mut(width).enumerate() {
                for (head, weight) in head.iter_mut().zip(weight.chunks_exact(outputs)) {
                    *head = weight[output];
                }
            }
        }
        let ours = head_bias.chunks_exact_mut(outputs);
        ours.zip(biases).for_each(|(ours, bias)| ours.copy_from_slice(bias));
        true
    }

    fn load_weight(&mut self, layer: usize, weight: &Tensor, rounded: &mut Tensor) {
        self.products.load(layer, weight, rounded);
    }

    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn load_bias(&mut self, layer: usize, bias: &Tensor) {
        let bias = bias.contiguous();
        // SAFETY: filled by the caller, who alone has it.
        self.bias[layer].copy_from_slice(unsafe { numbers(&bias) });
    }

    fn load_head(&mut self, _: &Tensor) {}

    fn reserve(&mut self, stack: &mut Stack, rows: i64) {
        stack.reserve(rows, true);
    }

    fn forward(&mut self, stack: &mut Stack, x: &Tensor) -> Tensor {
        match stack.kind {
            Kind::BFloat16 => self.forward_in::<Bf16>(stack, x),
            _ => self.forward_in::<f32>(stack, x),
        }
    }

    fn backward(
        &mut self,
        stack: &Stack,
        x: &Tensor,
        d_output: &Tensor,
        step: Option<StepGradient<'_>>,
    ) {
        match stack.kind {
            Kind::BFloat16 => self.backward_in::<Bf16>(stack, x, d_output, step),
            _ => self.backward_in::<f32>(stack, x, d_output, step),
        }
    }
}

/// Sizes of hidden layer `layer`'s arrays.
fn sizes(stack: &Stack, layer: usize, rows: i64) -> Sizes {
    let each = stack.spec.rows_per_network();
    Sizes {
        networks: stack.spec.n_networks,
        samples: (rows / each) as usize,
        actors: each as usize,
        own_bias: layer == 0,
        features: stack.spec.hidden[layer] as usize,
        outputs: stack.spec.output as usize,
    }
}
