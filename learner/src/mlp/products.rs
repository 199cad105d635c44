//! The products of hidden layers on a CPU: libtorch's, or in bfloat16 our own ([`crate::product`]).

use tch::{Kind, Tensor};

use super::passes::StepGradient;
use super::stack::Stack;
use crate::memory::{numbers, numbers_mut};
use crate::number::{Bf16, round_all};
use crate::product::{Activations, Biases, Gradients, Left, Native, Out, Packed, multiply};
use crate::unit::Unit;

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
        let size = [input as usize, units as usize];
        // SAFETY: made of zeros by the stack, which lends it for this call; parameters do not lie there.
        let rounded: &mut [Bf16] = unsafe { numbers_mut(rounded) };
        for (network, rounded) in rounded.chunks_exact_mut(size[0] * size[1]).enumerate() {
            let weight = weight.get(network as i64).contiguous();
            // SAFETY: parameters are filled, and nobody writes them while they are loaded.
            self.pack([layer, network], unsafe { numbers(&weight) }, rounded, size);
        }
    }

    /// Takes over a layer's weights `[in, H]`, one network's after another's, that nothing is folded into.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(super) fn load_as_they_are<'w>(
        &mut self,
        stack: &mut Stack,
        layer: usize,
        weights: impl Iterator<Item = &'w [f32]>,
    ) {
        let rounded = &mut stack.weight[layer];
        let (_, input, units) = rounded.size3().expect("[N, in, H]");
        let size = [input as usize, units as usize];
        let each = size[0] * size[1];
        if stack.kind == Kind::Float {
            // SAFETY: made of zeros by the stack, which lends it for this call; parameters do not lie there.
            let ours: &mut [f32] = unsafe { numbers_mut(rounded) };
            for (ours, weight) in ours.chunks_exact_mut(each).zip(weights) {
                ours.copy_from_slice(weight);
            }
            return;
        }
        // SAFETY: as above.
        let rounded: &mut [Bf16] = unsafe { numbers_mut(rounded) };
        let networks = rounded.chunks_exact_mut(each).zip(weights).enumerate();
        for (network, (rounded, weight)) in networks {
            if self.native.is_some() {
                self.pack([layer, network], weight, rounded, size);
            } else {
                round_all(weight, rounded);
            }
        }
    }

    /// Rounds a network's weights, and brings them and their transpose into the order of products.
    fn pack(
        &mut self,
        [layer, network]: [usize; 2],
        weight: &[f32],
        rounded: &mut [Bf16],
        [input, units]: [usize; 2],
    ) {
        round_all(weight, rounded);
        self.weight[layer][network].pack(rounded, input, units);
        if layer > 0 {
            self.transposed[layer][network].pack_transposed(rounded, units, input);
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
            Some(native) => each_left(input, |network, left| {
                let out = Out::Rounded(part(product, network, stack));
                multiply(native, left, &self.weight[layer][network], out);
            }),
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
            Some(native) => each_left(d, |network, left| {
                let out = Out::Rounded(part(below, network, stack));
                multiply(native, left, &self.transposed[layer][network], out);
            }),
            None => {
                let _ = d.bmm_out(below, &stack.weight[layer].transpose(1, 2));
            }
        }
    }

    /// Whether products go through a layer's units at once, forward and back: ours do, if no standardisation needs what is before them.
    pub(super) fn go_through_units(&self, stack: &Stack) -> bool {
        self.native.is_some() && !stack.spec.layer_norm
    }

    /// What the layer's units make of `input` times its weights, into `hidden` `[N, R, H]`; `bias` are those of the layer.
    ///
    /// # Panics
    /// Unless [`Self::go_through_units`].
    pub(super) fn activations(
        &self,
        stack: &Stack,
        layer: usize,
        (unit, bias): (Unit, &[f32]),
        input: &Tensor,
        hidden: &mut Tensor,
    ) {
        let native = self.native.expect("products of our own");
        each_left(input, |network, left| {
            let out = part(hidden, network, stack);
            let biases = biases(stack, layer, network);
            let out = Out::Activations(Activations { unit, bias, biases, out });
            multiply(native, left, &self.weight[layer][network], out);
        });
    }

    /// From the gradient by the layer's product, `d` `[N, R, H]`, that by the product of the layer below, into `below`. `hidden` are the activations of
    /// that layer; the gradient by its biases is added to `bias_gradient`.
    ///
    /// # Panics
    /// Unless [`Self::go_through_units`].
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(super) fn gradient_below(
        &self,
        stack: &Stack,
        layer: usize,
        (unit, bias_gradient): (Unit, &mut [f32]),
        [d, hidden]: [&Tensor; 2],
        below: &mut Tensor,
    ) {
        let native = self.native.expect("products of our own");
        // SAFETY: made by the pass forward, which has ended; nobody writes it before the next one.
        let hidden: &[Bf16] = unsafe { numbers(hidden) };
        let each = hidden.len() / stack.spec.n_networks;
        each_left(d, |network, left| {
            let out = Out::Gradients(Gradients {
                unit,
                hidden: &hidden[network * each..][..each],
                bias_gradient,
                biases: biases(stack, layer - 1, network),
                out: part(below, network, stack),
            });
            multiply(native, left, &self.transposed[layer][network], out);
        });
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
        let Some(native) = self.native else {
            let part = &stack.buffers.weight_gradient[layer];
            let _ = input.transpose(1, 2).bmm_out(part, d);
            step.take(&stack.spec, &stack.names(layer).0, part);
            return;
        };
        let (networks, rows, units) = d.size3().expect("[N, R, H]");
        let [rows, units, width] = [rows, units, input.size()[2]].map(|size| size as usize);
        let input_is_shared = is_shared(input);
        let [weight, _] = &stack.columns[layer];
        let mut gradient = step.gradient.shallow_clone();
        // SAFETY: the gradient is made of zeros by its owner, who lends it for this pass and reads it later. No other tensor
        // of the pass shares its memory.
        let gradient: &mut [f32] = unsafe { numbers_mut(&mut gradient) };
        let slots = gradient.chunks_exact_mut(stack.spec.len as usize);
        for (network, slot) in slots.take(networks as usize).enumerate() {
            if network == 0 || !input_is_shared {
                let mut copy = None;
                // SAFETY: filled before the pass began, and nobody writes until it has ended.
                let input = unsafe { matrix(input, network, &mut copy) };
                self.input.pack(input, rows, width);
            }
            let mut copy = None;
            // SAFETY: as above.
            self.gradient.pack(unsafe { matrix(d, network, &mut copy) }, rows, units);
            let slot = &mut slot[weight.clone()];
            let out = if step.is_first { Out::Widened(slot) } else { Out::Added(slot) };
            multiply(native, Left::Transposed(&self.input), &self.gradient, out);
        }
    }
}

/// A network's part of an array `[N, R, H]`, to be written.
#[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
fn part<'p>(array: &'p mut Tensor, network: usize, stack: &Stack) -> &'p mut [Bf16] {
    // SAFETY: products and what comes of them are buffers of the stack, made of zeros. Layers may share one, of which nobody else has a slice
    // now; it is not that of a product's factors.
    let array: &mut [Bf16] = unsafe { numbers_mut(array) };
    let each = array.len() / stack.spec.n_networks;
    &mut array[network * each..][..each]
}

/// Where the biases of a network's rows stand among those of a layer.
fn biases(stack: &Stack, layer: usize, network: usize) -> Biases {
    let width = stack.spec.hidden[layer] as usize;
    let own = stack.biases(layer) != stack.networks();
    Biases {
        first: network * width,
        step: stack.spec.n_networks * width,
        actors: if own { stack.spec.rows_per_network() as usize } else { 1 },
    }
}

/// Does something with each network's rows of `[N, R, K]`.
#[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
fn each_left(rows: &Tensor, mut with: impl FnMut(usize, Left<'_>)) {
    // What all networks share lies there once.
    let shared = is_shared(rows).then(|| rows.get(0).contiguous());
    for network in 0..rows.size()[0] as usize {
        let mut copy = None;
        // SAFETY: filled before the pass began, and nobody writes until it has ended.
        let left = Left::Rows(unsafe {
            match &shared {
                Some(shared) => numbers(shared),
                None => matrix(rows, network, &mut copy),
            }
        });
        with(network, left);
    }
}

/// Whether the matrices of a batch are one in memory.
fn is_shared(batch: &Tensor) -> bool {
    batch.size()[0] > 1 && batch.stride()[0] == 0
}

/// A matrix of a batch `[N, R, C]`: in place, or copied if there are gaps.
///
/// # Safety
/// As for [`numbers`].
#[expect(unsafe_code, reason = "only the caller knows which tensors share memory")]
unsafe fn matrix<'a>(batch: &'a Tensor, index: usize, copy: &'a mut Option<Tensor>) -> &'a [Bf16] {
    // SAFETY: the caller's promise.
    unsafe {
        if batch.is_contiguous() {
            let all = numbers(batch);
            let each = all.len() / batch.size()[0] as usize;
            &all[index * each..][..each]
        } else {
            numbers(copy.insert(batch.get(index as i64).contiguous()))
        }
    }
}
