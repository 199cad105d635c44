//! The actors' loss on a CPU: passes over the samples in plain Rust.
//!
//! Each number is made by the operations of the twin, in their order and each rounded, so the bits are the same. What libtorch has ways of its own for stays
//! libtorch's: exponentials, tanh and its derivative, and sums.

use tch::{Device, Kind, Tensor};

use super::operations::{ActorLoss, HALF_LN_TAU};
use crate::features::{Features, Loop, run_for};
use crate::limits::{clamp, maximum, minimum};
use crate::memory::{are_apart, numbers, numbers_mut};

/// Of each agent what is summed over samples, before the gradients by deviations: surrogate, divergence, whether the ratio is clipped.
pub(crate) const STATISTICS: usize = 3;

/// Room for the actors' loss of a chunk.
#[derive(Debug)]
pub(crate) struct ActorRoom {
    /// A, U, B.
    size: [usize; 3],
    /// `[2, A, U]`: reciprocal deviations, and what an action adds to a density's constant.
    deviations: Tensor,
    /// `[A, U, B]` each: tanh of the outputs, z, its square, and the gradient by the outputs where tanh squashes them.
    mean: Tensor,
    z: Tensor,
    squares: Tensor,
    gradient: Tensor,
    /// `[A, B]` each: of the probabilities. The logarithm begins as the sum of squares.
    log_ratio: Tensor,
    ratio: Tensor,
    /// `[A, 3 + U, B]` and `[A, 3 + U]`: the statistics, and the gradient by the logarithm of the deviation, without entropy; and their sums over samples.
    terms: Tensor,
    sums: Tensor,
    /// `[B]`, of the agent at hand.
    by_log_prob: Vec<f32>,
}

impl Default for ActorRoom {
    fn default() -> Self {
        Self::new([0; 3])
    }
}

impl ActorRoom {
    fn new(size: [usize; 3]) -> Self {
        let [a, u, b] = size;
        let tensor = |shape: &[usize]| {
            let shape: Vec<i64> = shape.iter().map(|&size| size as i64).collect();
            Tensor::zeros(shape, (Kind::Float, Device::Cpu))
        };
        let all = || tensor(&[a, u, b]);
        Self {
            size,
            deviations: tensor(&[2, a, u]),
            mean: all(),
            z: all(),
            squares: all(),
            gradient: all(),
            log_ratio: tensor(&[a, b]),
            ratio: tensor(&[a, b]),
            terms: tensor(&[a, STATISTICS + u, b]),
            sums: tensor(&[a, STATISTICS + u]),
            by_log_prob: vec![0.0; b],
        }
    }
}

impl ActorLoss {
    /// [`ActorLoss::finish_log_std`] of one action.
    pub(crate) fn finish_one_log_std(
        &self,
        gradient: f32,
        parameter: f32,
        own: Option<f32>,
    ) -> f32 {
        let above = f32::from(u8::from(parameter >= self.min_log_std as f32));
        let gradient = (gradient - self.entropy_coefficient as f32) * above;
        own.map_or(gradient, |own| gradient * own)
    }

    /// [`ActorLoss::gradient`] in passes: the gradient `[A, U, B]` by the networks' outputs, and `[A, 3 + U]` sums over samples: the statistics, and the gradient
    /// by the logarithm of the deviation. `parameter` and `own` are `[A, U]`, `columns` `[A, U + 2, B]`.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(crate) fn gradient_in_passes<'p>(
        &self,
        room: &'p mut ActorRoom,
        output: &Tensor,
        parameter: &[f32],
        own: Option<&[f32]>,
        columns: &[f32],
        batch: usize,
    ) -> (&'p Tensor, &'p [f32]) {
        let (a, u, b) = output.size3().expect("[A, U, B]");
        let size @ [a, u, b] = [a, u, b].map(|size| size as usize);
        assert_eq!((parameter.len(), columns.len()), (a * u, a * (u + 2) * b), "other samples");
        if room.size != size {
            *room = ActorRoom::new(size);
        }
        let ActorRoom {
            deviations,
            mean,
            z,
            squares,
            gradient,
            log_ratio,
            ratio,
            terms,
            sums,
            by_log_prob,
            ..
        } = room;
        let row = &[-1i64][..];
        // SAFETY: made of zeros with the room, which lends them to nobody else; libtorch does nothing until they are written.
        let (negative, constants) = unsafe { numbers_mut(deviations) }.split_at_mut(a * u);
        let floor = self.min_log_std as f32;
        for (index, &parameter) in parameter.iter().enumerate() {
            let log_std = if parameter < floor { floor } else { parameter };
            negative[index] = -log_std;
            constants[index] =
                own.map_or(log_std, |own| (log_std + HALF_LN_TAU as f32) * own[index]);
        }
        let mut inverse_std = deviations.get(0);
        let _ = inverse_std.exp_();
        let constant = deviations.get(1).sum_dim_intlist(row, false, Kind::Float);
        if self.squash_mean {
            let _ = output.tanh_out(mean);
        }
        let mean = if self.squash_mean { &*mean } else { output };
        assert!(are_apart(&[z, squares, log_ratio, mean]), "outputs lie in the room");
        // SAFETY: filled above; nobody writes there until the next chunk.
        let inverse_std = unsafe { numbers(&inverse_std) };
        let shared = Shared { actions: u, samples: b, inverse_std, own, columns };
        // SAFETY: outputs are the caller's, filled and apart from the room's tensors, which were made of zeros. libtorch does nothing until the pass has ended.
        unsafe {
            let (z, squares) = (numbers_mut(z), numbers_mut(squares));
            run_for(Features::detect(), StandardPass { shared, mean: numbers(mean), z, squares });
        }
        let _ = squares.sum_intlist_out(log_ratio, &[1i64][..], false, Kind::Float);
        // SAFETY: as above; what stands in the room is in tensors of its own.
        unsafe {
            run_for(
                Features::detect(),
                RatioPass {
                    shared,
                    half_ln_tau: if own.is_some() { 0.0 } else { (HALF_LN_TAU * u as f64) as f32 },
                    constant: numbers(&constant),
                    log_ratio: numbers_mut(log_ratio),
                },
            );
        }
        let _ = log_ratio.exp_out(ratio);
        // SAFETY: as above; what stands in the room is in tensors of its own.
        unsafe {
            run_for(
                Features::detect(),
                TermsPass {
                    shared,
                    clip: [1.0 - self.clip, 1.0 + self.clip].map(|limit| limit as f32),
                    dual_clip: (self.dual_clip > 0.0).then_some(self.dual_clip as f32),
                    scale: (-self.multiplier / batch as f64) as f32,
                    log_ratio: numbers(log_ratio),
                    ratio: numbers(ratio),
                    z: numbers_mut(z),
                    by_log_prob,
                    terms: numbers_mut(terms),
                },
            );
        }
        let _ = terms.sum_intlist_out(sums, row, false, Kind::Float);
        if self.squash_mean {
            let _ = Tensor::tanh_backward_grad_input(gradient, z, mean);
        }
        // SAFETY: as above; what stands in the room is in tensors of its own.
        let sums: &mut [f32] = unsafe { numbers_mut(sums) };
        for surrogate in sums.iter_mut().step_by(STATISTICS + u) {
            *surrogate *= -self.multiplier as f32;
        }
        (if self.squash_mean { gradient } else { z }, sums)
    }
}

/// What passes over the actors' samples read.
#[derive(Clone, Copy)]
struct Shared<'a> {
    actions: usize,
    samples: usize,
    /// `[A, U]`.
    inverse_std: &'a [f32],
    /// `[A, U]`.
    own: Option<&'a [f32]>,
    /// `[A, U + 2, B]`.
    columns: &'a [f32],
}

impl Shared<'_> {
    /// One where an action moves a joint, zero where it moves nothing.
    #[inline(always)]
    fn own(&self, index: usize) -> f32 {
        self.own.map_or(1.0, |own| own[index])
    }
}

/// z = (a − μ) / σ, and z².
struct StandardPass<'a> {
    shared: Shared<'a>,
    /// `[A, U, B]` each.
    mean: &'a [f32],
    z: &'a mut [f32],
    squares: &'a mut [f32],
}

impl Loop for StandardPass<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Shared { actions: u, samples: b, inverse_std, columns, .. } = self.shared;
        for (index, z) in self.z.chunks_exact_mut(b).enumerate() {
            let (inverse, own) = (inverse_std[index], self.shared.own(index));
            let (agent, action) = (index / u, index % u);
            let taken = &columns[(agent * (u + 2) + action) * b..][..b];
            let (mean, squares) =
                (&self.mean[index * b..][..b], &mut self.squares[index * b..][..b]);
            for i in 0..b {
                z[i] = (taken[i] - mean[i]) * inverse * own;
                squares[i] = z[i] * z[i];
            }
        }
    }
}

/// The logarithm of the ratio of probabilities, from the sum of squares.
struct RatioPass<'a> {
    shared: Shared<'a>,
    /// U ½ ln 2π, or zero where `constant` has it.
    half_ln_tau: f32,
    /// `[A]`: Σ ln σ, where some actions move nothing with ½ ln 2π of each that does.
    constant: &'a [f32],
    /// `[A, B]`.
    log_ratio: &'a mut [f32],
}

impl Loop for RatioPass<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Shared { actions: u, samples: b, columns, .. } = self.shared;
        for (agent, log_ratio) in self.log_ratio.chunks_exact_mut(b).enumerate() {
            let constant = self.constant[agent] + self.half_ln_tau;
            let old = &columns[(agent * (u + 2) + u) * b..][..b];
            for i in 0..b {
                log_ratio[i] = log_ratio[i] * -0.5 - constant - old[i];
            }
        }
    }
}

/// What is summed over samples, and the gradient by the means.
struct TermsPass<'a> {
    shared: Shared<'a>,
    clip: [f32; 2],
    dual_clip: Option<f32>,
    /// −k / B.
    scale: f32,
    /// `[A, B]`.
    log_ratio: &'a [f32],
    /// `[A, B]`.
    ratio: &'a [f32],
    /// In: z; out: the gradient by the means, `[A, U, B]`.
    z: &'a mut [f32],
    /// `[B]`: gradient by the logarithm of the probability, of the agent at hand.
    by_log_prob: &'a mut [f32],
    /// Out: `[A, 3 + U, B]`.
    terms: &'a mut [f32],
}

impl Loop for TermsPass<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { shared, clip, dual_clip, scale, log_ratio, ratio, .. } = self;
        let Shared { actions: u, samples: b, inverse_std, columns, .. } = shared;
        let (z, by_log_prob) = (self.z, &mut self.by_log_prob[..b]);
        for (agent, terms) in self.terms.chunks_exact_mut((STATISTICS + u) * b).enumerate() {
            let (ratio, log_ratio) = (&ratio[agent * b..][..b], &log_ratio[agent * b..][..b]);
            let advantage = &columns[agent * (u + 2) * b..][(u + 1) * b..][..b];
            let (surrogate, rest) = terms.split_at_mut(b);
            let (kl, rest) = rest.split_at_mut(b);
            let (outside, by_log_std) = rest.split_at_mut(b);
            for i in 0..b {
                let (ratio, advantage) = (ratio[i], advantage[i]);
                let clipped = clamp(ratio, clip);
                let (plain, limited) = (ratio * advantage, clipped * advantage);
                let mut active = plain <= limited;
                let mut least_of_both = minimum(plain, limited);
                if let Some(dual_clip) = dual_clip {
                    let least = advantage * dual_clip;
                    let least = if least > 0.0 { 0.0 } else { least };
                    active &= plain >= least;
                    least_of_both = maximum(least_of_both, least);
                }
                surrogate[i] = least_of_both;
                kl[i] = ratio - 1.0 - log_ratio[i];
                outside[i] = f32::from(u8::from(ratio != clipped));
                by_log_prob[i] = plain * f32::from(u8::from(active)) * scale;
            }
            for action in 0..u {
                let index = agent * u + action;
                let (inverse, own) = (inverse_std[index], shared.own(index));
                let z = &mut z[index * b..][..b];
                let by_log_std = &mut by_log_std[action * b..][..b];
                for i in 0..b {
                    by_log_std[i] = by_log_prob[i] * (z[i] * z[i] - own);
                    z[i] = z[i] * inverse * by_log_prob[i];
                }
            }
        }
    }
}
