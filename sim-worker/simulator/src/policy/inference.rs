//! Evaluation of a packed policy with environments in lanes.
//!
//! Loops are written out: a closure is a function of its own, which the compiler builds without the
//! processor features of the lane function around it.

use proto::config::{Activation, InputNorm};

use super::dense::tile_groups;
use super::pack::{Affine, Policy, Product};
use crate::scalar::{Kernel, Real, elementary};

/// ε of LayerNorm (Ba, Kiros and Hinton 2016), PyTorch's default.
const LAYER_NORM_EPSILON: f64 = 1e-5;

/// Activations of one network for all lane groups of the actors that share it: two buffers that layers alternate, and one for pairs.
#[derive(Debug, Clone)]
pub struct Scratch<S: Real> {
    stride: usize,
    ping: Vec<S>,
    pong: Vec<S>,
    pairs: Vec<S::Pair>,
}

impl<S: Real> Scratch<S> {
    /// Room for `policy` on `groups` lane groups.
    pub fn new(policy: &Policy, groups: usize) -> Self {
        let stride = policy.stride();
        let buffer = vec![S::zero(); stride * groups];
        let pairs = vec![S::pair(S::zero(), S::zero()); stride * groups];
        Self { stride, ping: buffer.clone(), pong: buffer, pairs }
    }
}

impl Policy {
    /// Mean actions of `actor`, or of all that share its network.
    ///
    /// Shape: `observations` is `[group][input]`, `means` is `[group][output]`; groups of several actors stand one after the other.
    #[inline(always)]
    pub fn mean<S: Real>(
        &self,
        actor: usize,
        observations: &[S],
        scratch: &mut Scratch<S>,
        means: &mut [S],
    ) {
        S::compiled(Mean { policy: self, actor, observations, scratch, means });
    }

    #[inline(always)]
    fn infer<S: Real>(
        &self,
        actor: usize,
        observations: &[S],
        scratch: &mut Scratch<S>,
        means: &mut [S],
    ) {
        let (input, output) = (self.input, self.output);
        let limit = S::splat(self.action_limit);
        let groups = means.len() / output;
        assert_eq!(observations.len(), groups * input, "one row of inputs a lane group");
        assert!(scratch.ping.len() >= groups * scratch.stride, "scratch is made for fewer groups");
        let network = &self.networks[self.network_of[actor]];
        let Scratch { stride, ping, pong, pairs } = scratch;
        let stride = *stride;
        let mut group = 0;
        while group < groups {
            let width = tile_groups(group, groups);
            for g in 0..width {
                let from = &observations[(group + g) * input..][..input];
                let to = &mut ping[group * stride..];
                for (o, &value) in from.iter().enumerate() {
                    to[o * width + g] = value;
                }
            }
            group += width;
        }
        if let Some(affine) = &network.input {
            let mut group = 0;
            while group < groups {
                let width = tile_groups(group, groups);
                let x = &mut ping[group * stride..];
                match self.input_norm {
                    InputNorm::Running => standardise(x, width, affine, self.input_clip),
                    _ => layer_norm(x, width, affine),
                }
                group += width;
            }
        }
        let mut features = input;
        for hidden in &network.hidden {
            match &hidden.product {
                Product::Single(dense) => dense.apply(ping, pong, groups, stride),
                Product::Pairs(dense) => {
                    let mut group = 0;
                    while group < groups {
                        let width = tile_groups(group, groups);
                        let from = group * stride;
                        to_pairs::<S>(&ping[from..], &mut pairs[from..], features, width);
                        group += width;
                    }
                    dense.apply(pairs, pong, groups, stride);
                }
            }
            features = hidden.product.outputs();
            let mut group = 0;
            while group < groups {
                let width = tile_groups(group, groups);
                let x = &mut pong[group * stride..];
                activate(&mut x[..features * width], self.activation);
                if let Some(affine) = &hidden.norm {
                    layer_norm(x, width, affine);
                }
                group += width;
            }
            std::mem::swap(ping, pong);
        }
        network.head.apply(ping, pong, groups, stride);
        let mut group = 0;
        while group < groups {
            let width = tile_groups(group, groups);
            for g in 0..width {
                for u in 0..output {
                    let y = pong[group * stride + u * width + g];
                    means[(group + g) * output + u] =
                        if self.squash_mean { y.tanh() * limit } else { y };
                }
            }
            group += width;
        }
    }
}

struct Mean<'a, S: Real> {
    policy: &'a Policy,
    actor: usize,
    observations: &'a [S],
    scratch: &'a mut Scratch<S>,
    means: &'a mut [S],
}

impl<S: Real> Kernel<S> for Mean<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { policy, actor, observations, scratch, means } = self;
        policy.infer(actor, observations, scratch, means);
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
