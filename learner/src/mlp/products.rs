//! The products of hidden layers on a CPU: libtorch's, or in bfloat16 our own ([`crate::product`]).

use tch::{Kind, Tensor};

use super::passes::StepGradient;
use super::stack::Stack;
use crate::memory::{numbers, numbers_mut};
use crate::number::{Bf16, round_all};
use crate::product::{Left, Native, Out, Packed, multiply};

/// What multiplies, and its memory.
#[derive(Debug)]
pub(super) struct Products {
    /// What ours are made with; libtorch multiplies if that is nothing.
    native: Option<Native>,
    /// Weights of each hidden layer and network.
    weight: Vec<Vec<Packed>>,
    /// Their transposes, but of the first layer.
    transposed: Vec<Vec<Packed>>,
    /// Of the network at hand.
    input: Packed,
    gradient: Packed,
}

impl Products {
    /// For the layers of `stack`, in bfloat16 if ours are made with `native`.
    pub(super) fn new(stack: &Stack, native: Option<Native>) -> Self {
        assert!(native.is_none() || stack.kind == Kind::BFloat16, "ours are of bfloat16");
        let layers = || {
            let networks = || (0..stack.spec.n_networks).map(|_| Packed::default()).collect();
            stack.weight.iter().map(|_| networks()).collect()
        };
        let (weight, transposed) = (layers(), layers());
        Self { native, weight, transposed, input: Packed::default(), gradient: Packed::default() }
    }

    /// Whether an input that all networks share may lie in memory once: libtorch would copy it for each product.
    pub(super) fn share_input(&self) -> bool {
        self.native.is_some()
    }

    /// Takes over a layer's folded weights `[N, in, H]`, and rounds them.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(super) fn load(&mut self, layer: usize, weight: &Tensor, rounded: &mut Tensor) {
        if self.native.is_none() {
            rounded.copy_(weight);
            return;
        }
        let (_, input, units) = weight.size3().expect("[N, in, H]");
        let (input, units) = (input as usize, units as usize);
        // SAFETY: made of zeros by the stack, which lends it for this call; parameters do not lie there.
        let rounded: &mut [Bf16] = unsafe { numbers_mut(rounded) };
        for (network, rounded) in rounded.chunks_exact_mut(input * units).enumerate() {
            let weight = weight.get(network as i64).contiguous();
            // SAFETY: parameters are filled, and nobody writes them while they are loaded.
            round_all(unsafe { numbers(&weight) }, rounded);
            self.weight[layer][network].pack(rounded, input, units);
            if layer > 0 {
                self.transposed[layer][network].pack_transposed(rounded, units, input);
            }
        }
    }

    /// `input` `[N, R, in]` times the layer's weights, into `product` `[N, R, H]`.
    pub(super) fn forward(
        &self,
        stack: &Stack,
        layer: usize,
        input: &Tensor,
        product: &mut Tensor,
    ) {
        match self.native {
            Some(native) => multiply_rows(native, input, &self.weight[layer], product),
            None => {
                let _ = input.bmm_out(product, &stack.weight[layer]);
            }
        }
    }

    /// The gradient by the layer's input, into `below` `[N, R, in]`, from that by its product, `d` `[N, R, H]`.
    pub(super) fn input_gradient(
        &self,
        stack: &Stack,
        layer: usize,
        d: &Tensor,
        below: &mut Tensor,
    ) {
        match self.native {
            Some(native) => multiply_rows(native, d, &self.transposed[layer], below),
            None => {
                let _ = d.bmm_out(below, &stack.weight[layer].transpose(1, 2));
            }
        }
    }

    /// The gradient by the layer's weights, into `step`.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(super) fn weight_gradient(
        &mut self,
        stack: &Stack,
        layer: usize,
        [input, d]: [&Tensor; 2],
        step: StepGradient<'_>,
    ) {
        let (name, _) = stack.names(layer);
        let Some(native) = self.native else {
            let part = &stack.buffers.weight_gradient[layer];
            let _ = input.transpose(1, 2).bmm_out(part, d);
            step.take(&stack.spec, &name, part);
            return;
        };
        let (networks, rows, units) = d.size3().expect("[N, R, H]");
        let (rows, width) = (rows as usize, input.size()[2] as usize);
        let input_is_shared = input.stride()[0] == 0;
        let slot = stack.spec.learned(&name, step.gradient);
        for network in 0..networks {
            if network == 0 || !input_is_shared {
                let input = input.get(network).contiguous();
                // SAFETY: filled before the pass began, and nobody writes until it has ended.
                self.input.pack(unsafe { numbers(&input) }, rows, width);
            }
            let d = d.get(network);
            // SAFETY: as above.
            self.gradient.pack(unsafe { numbers(&d) }, rows, units as usize);
            let mut slot = slot.get(network);
            // SAFETY: the gradient is made of zeros by its owner, who lends it for this pass and reads it later. No other tensor
            // of the pass shares its memory.
            let slot: &mut [f32] = unsafe { numbers_mut(&mut slot) };
            let out = if step.is_first { Out::Widened(slot) } else { Out::Added(slot) };
            multiply(native, Left::Transposed(&self.input), &self.gradient, out);
        }
    }
}

/// Rows `[N, R, K]` times each network's right factor `[K, M]`, into `product` `[N, R, M]`.
#[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
fn multiply_rows(native: Native, rows: &Tensor, right: &[Packed], product: &mut Tensor) {
    // SAFETY: products are buffers of the stack, made of zeros. Layers may share one, of which nobody else has a slice now; it is not that of `rows`.
    let product: &mut [Bf16] = unsafe { numbers_mut(product) };
    let each = product.len() / right.len();
    for (network, (right, product)) in right.iter().zip(product.chunks_exact_mut(each)).enumerate()
    {
        let rows = rows.get(network as i64).contiguous();
        // SAFETY: filled before the pass began, and nobody writes until it has ended.
        let left = Left::Rows(unsafe { numbers(&rows) });
        multiply(native, left, right, Out::Rounded(product));
    }
}
