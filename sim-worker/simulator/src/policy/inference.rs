//! Evaluation of a packed policy with environments in lanes.
//!
//! Loops are written out: a closure is a function of its own, which the compiler builds without the
//! processor features of the lane function around it.

use proto::config::{Activation, InputNorm};

use super::dense::tile_groups;
use super::pack::{Affine, Network, Policy, Product};
use super::registers::{Full, MAX_JOINED, Packing, Single, joined};
use crate::scalar::{Kernel, Real, elementary};

/// ε of LayerNorm (Ba, Kiros and Hinton 2016), PyTorch's default.
const LAYER_NORM_EPSILON: f64 = 1e-5;

/// Activations of one network for all lane groups of the actors that share it.
#[derive(Debug, Clone)]
pub struct Scratch<S: Real> {
    /// Of groups that fill registers together.
    full: Buffers<S::Register>,
    /// Of what is left of them.
    rest: Buffers<S>,
}

/// Two buffers that layers alternate, and one for pairs.
#[derive(Debug, Clone)]
struct Buffers<R: Real> {
    stride: usize,
    ping: Vec<R>,
    pong: Vec<R>,
    pairs: Vec<R::Pair>,
}

impl<S: Real> Scratch<S> {
    /// Room for `policy` on `groups` lane groups.
    pub fn new(policy: &Policy, groups: usize) -> Self {
        let stride = policy.stride();
        let full = Buffers::new(stride, groups / joined::<S>());
        Self { full, rest: Buffers::new(stride, joined::<S>() - 1) }
    }
}

impl<R: Real> Buffers<R> {
    fn new(stride: usize, registers: usize) -> Self {
        let buffer = vec![R::zero(); stride * registers];
        let pairs = vec![R::pair(R::zero(), R::zero()); stride * registers];
        Self { stride, ping: buffer.clone(), pong: buffer, pairs }
    }
}

impl Policy {
    /// Mean actions of `actors`, who share a network.
    ///
    /// Shape: `observations` is `[actor][group][input]`, `means` is `[actor][group][output]`.
    ///
    /// # Panics
    /// If their networks differ.
    #[inline(always)]
    pub fn mean<S: Real>(
        &self,
        actors: &[usize],
        observations: &[S],
        scratch: &mut Scratch<S>,
        means: &mut [S],
    ) {
        S::compiled(Mean { policy: self, actors, observations, scratch, means });
    }
}

struct Mean<'a, S: Real> {
    policy: &'a Policy,
    actors: &'a [usize],
    observations: &'a [S],
    scratch: &'a mut Scratch<S>,
    means: &'a mut [S],
}

impl<S: Real> Kernel<S> for Mean<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { policy, actors, observations, scratch, means } = self;
        let (input, output) = (policy.input, policy.output);
        let groups = means.len() / output;
        assert_eq!(observations.len(), groups * input, "one row of inputs a lane group");
        assert_eq!(groups % actors.len(), 0, "as many groups of each actor");
        for actor in actors {
            assert_eq!(policy.network_of[*actor], policy.network_of[actors[0]], "one network");
        }
        let crowd = Crowd { actors, groups: groups / actors.len() };
        let full = groups / joined::<S>() * joined::<S>();
        let (observations, left) = observations.split_at(full * input);
        let (means, left_means) = means.split_at_mut(full * output);
        infer::<S, Full>(policy, crowd, 0, observations, &mut scratch.full, means);
        // A constant condition: this is compiled only where there can be some.
        if joined::<S>() > 1 && !left.is_empty() {
            infer::<S, Single>(policy, crowd, full, left, &mut scratch.rest, left_means);
        }
    }
}

/// Who shares a network: lane groups of one actor after those of the other.
#[derive(Clone, Copy)]
struct Crowd<'a> {
    actors: &'a [usize],
    /// Of each actor.
    groups: usize,
}

/// Takes rows of lane groups, from `first_group` of all on, through their network, in registers as `P` packs them.
#[inline(always)]
fn infer<S: Real, P: Packing<S>>(
    policy: &Policy,
    crowd: Crowd<'_>,
    first_group: usize,
    observations: &[S],
    buffers: &mut Buffers<P::Register>,
    means: &mut [S],
) {
    let (input, output) = (policy.input, policy.output);
    let registers = means.len() / (P::GROUPS * output);
    let stride = buffers.stride;
    assert!(buffers.ping.len() >= registers * stride, "scratch is made for fewer groups");
    let mut register = 0;
    while register < registers {
        let width = tile_groups(register, registers);
        for r in 0..width {
            let first = (register + r) * P::GROUPS * input;
            let from = &observations[first..first + P::GROUPS * input];
            let to = &mut buffers.ping[register * stride..];
            for o in 0..input {
                to[o * width + r] = P::join(&from[o..], input);
            }
            let group = first_group + (register + r) * P::GROUPS;
            let out = &mut buffers.pong[register * stride + r..];
            start::<S, P>(policy, crowd, group, out, width);
        }
        register += width;
    }
    let network = &policy.networks[policy.network_of[crowd.actors[0]]];
    P::Register::compiled(Layers { policy, network, buffers, registers });
    let limit = P::Register::splat(policy.action_limit);
    let mut register = 0;
    while register < registers {
        let width = tile_groups(register, registers);
        for r in 0..width {
            let first = (register + r) * P::GROUPS * output;
            for u in 0..output {
                let y = buffers.pong[register * stride + u * width + r];
                let mean = if policy.squash_mean { y.tanh() * limit } else { y };
                for part in 0..P::GROUPS {
                    means[first + part * output + u] = P::part(mean, part);
                }
            }
        }
        register += width;
    }
}

/// Writes a register's first biases, those of the actors of its groups from `group` on, a unit `width` places after the other.
#[inline(always)]
fn start<S: Real, P: Packing<S>>(
    policy: &Policy,
    crowd: Crowd<'_>,
    group: usize,
    out: &mut [P::Register],
    width: usize,
) {
    let mut of_groups: [&[f32]; MAX_JOINED] = [&[]; MAX_JOINED];
    for part in 0..P::GROUPS {
        of_groups[part] = &policy.first_bias[crowd.actors[(group + part) / crowd.groups]];
    }
    for unit in 0..of_groups[0].len() {
        let mut parts = [S::zero(); MAX_JOINED];
        for part in 0..P::GROUPS {
            parts[part] = S::splat(f64::from(of_groups[part][unit]));
        }
        out[unit * width] = P::join(&parts, 1);
    }
}

/// A network's layers on as many registers: from inputs in `ping`, and first biases in `pong`, to outputs in `pong`.
struct Layers<'a, R: Real> {
    policy: &'a Policy,
    network: &'a Network,
    buffers: &'a mut Buffers<R>,
    registers: usize,
}

impl<R: Real> Kernel<R> for Layers<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { policy, network, buffers, registers } = self;
        let Buffers { stride, ping, pong, pairs } = buffers;
        let stride = *stride;
        if let Some(affine) = &network.input {
            let mut register = 0;
            while register < registers {
                let width = tile_groups(register, registers);
                let x = &mut ping[register * stride..];
                match policy.input_norm {
                    InputNorm::Running => standardise(x, width, affine, policy.input_clip),
                    _ => layer_norm(x, width, affine),
                }
                register += width;
            }
        }
        let mut features = policy.input;
        for (layer, hidden) in network.hidden.iter().enumerate() {
            match &hidden.product {
                Product::Single(dense) if layer == 0 => {
                    dense.add_to(ping, pong, registers, stride);
                }
                Product::Single(dense) => dense.apply(ping, pong, registers, stride),
                Product::Pairs(dense) => {
                    let mut register = 0;
                    while register < registers {
                        let width = tile_groups(register, registers);
                        let from = register * stride;
                        to_pairs::<R>(&ping[from..], &mut pairs[from..], features, width);
                        register += width;
                    }
                    dense.apply(pairs, pong, registers, stride);
                }
                Product::Widened(dense) => {
                    let mut register = 0;
                    while register < registers {
                        let width = tile_groups(register, registers);
                        round_pairs::<R>(&mut ping[register * stride..], features, width);
                        register += width;
                    }
                    dense.apply(ping, pong, registers, stride);
                }
            }
            features = hidden.product.outputs();
            let mut register = 0;
            while register < registers {
                let width = tile_groups(register, registers);
                let x = &mut pong[register * stride..];
                activate(&mut x[..features * width], policy.activation);
                if let Some(affine) = &hidden.norm {
                    layer_norm(x, width, affine);
                }
                register += width;
            }
            std::mem::swap(ping, pong);
        }
        network.head.apply(ping, pong, registers, stride);
    }
}

/// Rounds `features` of a tile to pairs of bfloat16; an odd last one stands beside zero.
#[inline(always)]
fn to_pairs<S: Real>(x: &[S], pairs: &mut [S::Pair], features: usize, width: usize) {
    for pair in 0..features.div_ceil(2) {
        for g in 0..width {
            let first = x[2 * pair * width + g];
            let second =
                if 2 * pair + 1 < features { x[(2 * pair + 1) * width + g] } else { S::zero() };
            pairs[pair * width + g] = S::pair(first, second);
        }
    }
}

/// Rounds likewise, in place: of each two numbers the second comes first.
#[inline(always)]
fn round_pairs<S: Real>(x: &mut [S], features: usize, width: usize) {
    for pair in 0..features.div_ceil(2) {
        for g in 0..width {
            let first = x[2 * pair * width + g].to_bf16();
            let at = (2 * pair + 1) * width + g;
            let second = if 2 * pair + 1 < features { x[at].to_bf16() } else { S::zero() };
            (x[2 * pair * width + g], x[at]) = (second, first);
        }
    }
}

/// clip((x − mean) · inverse_std, ± clip).
#[inline(always)]
fn standardise<S: Real>(x: &mut [S], width: usize, affine: &Affine, clip: f32) {
    let clip = S::splat(f64::from(clip));
    let rows = x.chunks_exact_mut(width).zip(affine.first.iter().zip(&affine.second));
    for (row, (&mean, &inverse_std)) in rows {
        let (mean, scale) = (S::splat(f64::from(mean)), S::splat(f64::from(inverse_std)));
        for value in row {
            *value = ((*value - mean) * scale).clamp(-clip, clip);
        }
    }
}

/// LayerNorm over the features of each environment, in two passes, with gain and shift.
///
/// Sums run as four interleaved chains, which hides the latency of additions, in an order that only
/// the number of features fixes.
#[inline(always)]
fn layer_norm<S: Real>(x: &mut [S], width: usize, affine: &Affine) {
    let n = affine.first.len();
    let scale = S::splat(1.0 / n as f64);
    for g in 0..width {
        let mut sums = [S::zero(); 4];
        for i in 0..n {
            sums[i % 4] += x[i * width + g];
        }
        let mean = ((sums[0] + sums[1]) + (sums[2] + sums[3])) * scale;
        let mut sums = [S::zero(); 4];
        for i in 0..n {
            let d = x[i * width + g] - mean;
            sums[i % 4] = d.mul_add(d, sums[i % 4]);
        }
        let variance = ((sums[0] + sums[1]) + (sums[2] + sums[3])) * scale;
        let inverse = (variance + S::splat(LAYER_NORM_EPSILON)).sqrt().recip();
        for i in 0..n {
            let gain = S::splat(f64::from(affine.first[i])) * inverse;
            let shift = S::splat(f64::from(affine.second[i]));
            let value = &mut x[i * width + g];
            *value = (*value - mean).mul_add(gain, shift);
        }
    }
}

#[inline(always)]
fn activate<S: Real>(x: &mut [S], activation: Activation) {
    match activation {
        Activation::Relu => {
            for value in x {
                *value = value.max(S::zero());
            }
        }
        Activation::Elu => {
            for value in x {
                // Where e^x is cut off it is lost beside the one.
                let negative = elementary::exp_of_negative(value.min(S::zero())) - S::one();
                *value = S::select(value.gt(S::zero()), *value, negative);
            }
        }
        Activation::Tanh => {
            for value in x {
                *value = value.tanh();
            }
        }
    }
}
