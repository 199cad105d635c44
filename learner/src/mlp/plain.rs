//! The passes on a CPU with ReLU or ELU: what stands between two products (`products.rs`) is one loop over the samples in plain Rust.

use proto::config::Activation;
use tch::{Device, Kind, Tensor};

use super::fused::{Backward, Forward, HeadBackward, HeadForward, RowPasses, Sizes, Unit};
use super::passes::{Passes, StepGradient};
use super::products::Products;
use super::stack::Stack;
use crate::memory::{Element, are_apart, numbers, numbers_mut};
use crate::number::{Bf16, Number};
use crate::product::Native;

/// One loop over the samples a layer.
#[derive(Debug)]
pub(super) struct PlainPasses {
    rows: RowPasses,
    products: Products,
    /// `[A, H]` of the first hidden layer, `[N, H]` of the others, folded.
    bias: Vec<Tensor>,
}

impl PlainPasses {
    /// For the layers of `stack`, if they are of those that it can do. Products in bfloat16 are ours by `native`, or libtorch's.
    pub(super) fn new(stack: &Stack, native: Option<Native>) -> Option<Self> {
        let unit = match stack.activation {
            Activation::Relu => Unit::Relu,
            Activation::Elu => Unit::Elu,
            Activation::Tanh => return None,
        };
        let options = (Kind::Float, stack.device);
        let hidden = stack.spec.hidden.iter().enumerate();
        (stack.device == Device::Cpu).then(|| Self {
            rows: RowPasses::new(unit),
            products: Products::new(stack, native),
            bias: hidden
                .map(|(layer, &units)| Tensor::zeros([stack.biases(layer), units], options))
                .collect(),
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
        for layer in 0..layers {
            let width = stack.spec.hidden[layer];
            let mut product = stack.chunk(&stack.buffers.active[layer], rows, width);
            let mut hidden = stack.chunk(&stack.buffers.standard[layer], rows, width);
            self.products.forward(stack, layer, &input, &mut product);
            let deviations = [stack.networks(), rows];
            let mut inverse_std = stack.spec.layer_norm.then(|| Tensor::zeros(deviations, float));
            let sizes = sizes(stack, layer, rows);
            // SAFETY: every tensor here was made of zeros by this type, its stack or this call and has a
            // storage of its own: `active` and `standard` of this layer are two buffers. No handle of them
            // has left it, and libtorch does nothing until the pass has ended.
            let arrays = unsafe {
                Forward {
                    product: numbers(&product),
                    bias: numbers(&self.bias[layer]),
                    hidden: numbers_mut(&mut hidden),
                    inverse_std: inverse_std.as_mut().map(|tensor| numbers_mut(tensor)),
                    head: (layer + 1 == layers).then(|| HeadForward {
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
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn backward_in<T: Number + Element>(
        &mut self,
        stack: &Stack,
        x: &Tensor,
        d_output: &Tensor,
        step: Option<StepGradient<'_>>,
    ) {
        let (networks, rows, layers) = (stack.networks(), x.size()[1], stack.spec.hidden.len());
        let float = (Kind::Float, stack.device);
        let d_output = d_output.contiguous();
        for layer in (0..layers).rev() {
            let width = stack.spec.hidden[layer];
            let mut d = stack.gradient_chunk(layers - 1 - layer, rows, width);
            let product = stack.chunk(&stack.buffers.active[layer], rows, width);
            let hidden = stack.chunk(&stack.buffers.standard[layer], rows, width);
            let mut d_bias = Tensor::zeros([stack.biases(layer), width], float);
            let mut d_head = (layer + 1 == layers).then(|| {
                let outputs = stack.spec.output;
                let weight = Tensor::zeros([networks, outputs, width], float);
                (weight, Tensor::zeros([networks, outputs], float))
            });
            assert!(
                are_apart(&[&d, &d_output]),
                "the loss's gradient lies in a buffer of the passes"
            );
            let sizes = sizes(stack, layer, rows);
            // SAFETY: `d_output` is filled by the caller and apart from what is written. Every other
            // tensor here was made of zeros by this type, its stack or this call and has a storage of its
            // own: `active`, `standard` and `gradient` are three buffers. No handle of what is written has
            // left it, and libtorch does nothing until the pass has ended.
            let arrays = unsafe {
                Backward {
                    product: numbers(&product),
                    bias: numbers(&self.bias[layer]),
                    hidden: numbers(&hidden),
                    inverse_std: stack.buffers.inverse_std.get(layer).map(|tensor| numbers(tensor)),
                    gradient: numbers_mut(&mut d),
                    bias_gradient: numbers_mut(&mut d_bias),
                    head: d_head.as_mut().map(|(weight, bias)| HeadBackward {
                        weight: numbers(&stack.head),
                        output_gradient: numbers(&d_output),
                        weight_gradient: numbers_mut(weight),
                        bias_gradient: numbers_mut(bias),
                    }),
                }
            };
            self.rows.backward::<T>(sizes, arrays);
            if let Some(step) = step {
                if let Some((weight, bias)) = &d_head {
                    step.take(&stack.spec, "head.weight", &weight.transpose(1, 2));
                    step.take(&stack.spec, "head.bias", bias);
                }
                let input = if layer == 0 {
                    x.shallow_clone()
                } else {
                    stack.chunk(
                        &stack.buffers.standard[layer - 1],
                        rows,
                        stack.spec.hidden[layer - 1],
                    )
                };
                self.products.weight_gradient(stack, layer, [&input, &d], step);
                let (_, bias_name) = stack.names(layer);
                step.take(&stack.spec, &bias_name, &d_bias);
            }
            if layer > 0 {
                let mut below =
                    stack.gradient_chunk(layers - layer, rows, stack.spec.hidden[layer - 1]);
                self.products.input_gradient(stack, layer, &d, &mut below);
            }
        }
    }
}

impl Passes for PlainPasses {
    fn share_input(&self) -> bool {
        self.products.share_input()
    }

    fn load_weight(&mut self, layer: usize, weight: &Tensor, rounded: &mut Tensor) {
        self.products.load(layer, weight, rounded);
    }

    fn load_bias(&mut self, layer: usize, bias: &Tensor) {
        self.bias[layer].copy_(&bias.squeeze_dim(1));
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
