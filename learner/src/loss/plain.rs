//! The losses on a CPU: passes over the samples in plain Rust.
//!
//! Each number is made by the operations of the twin, in their order and each rounded, so the bits are the same. What libtorch has ways of its own for stays
//! libtorch's: exponentials, tanh and its derivative, and sums over samples.

use tch::{Device, Kind, Tensor};

use super::{ActorGradient, ActorLoss, ActorSamples, CriticLoss, CriticSamples, constant};
use crate::features::{Features, Loop, run_for};
use crate::memory::{are_apart, numbers, numbers_mut};

/// So many numbers libtorch adds one after the other, in a sum over rows.
pub(super) const MOST_ACTIONS: i64 = 16;

/// Rows of what is summed over samples, before those of the deviations: surrogate, divergence, whether the ratio is clipped.
const STATISTICS: usize = 3;

/// Whether the passes can read these tensors in place.
pub(super) fn can_do(tensors: &[&Tensor]) -> bool {
    tensors.iter().all(|tensor| {
        tensor.device() == Device::Cpu && tensor.kind() == Kind::Float && tensor.is_contiguous()
    })
}

impl ActorLoss {
    /// [`ActorLoss::gradient`] in passes.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(super) fn gradient_in_passes(
        &self,
        output: &Tensor,
        parameter: &Tensor,
        own: Option<&Tensor>,
        samples: &ActorSamples,
        batch: i64,
    ) -> ActorGradient {
        let (a, u, b) = output.size3().expect("[A, U, B]");
        let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
        let log_std = self.log_std(parameter);
        let inverse_std = log_std.neg().exp();
        let constant = constant(&log_std, own);
        let own = own.map(Tensor::contiguous);
        let mean = if self.squash_mean { output.tanh() } else { output.shallow_clone() };
        let [mut z, mut log_ratio] = [zeros(&[a, u, b]), zeros(&[a, b])];
        assert!(are_apart(&[&z, &log_ratio, &mean, &samples.0]), "fresh memory");
        // SAFETY: what is read is filled; what is written was made of zeros here and is apart. No other thread has a handle.
        let shared = unsafe {
            Shared {
                actions: u as usize,
                samples: b as usize,
                inverse_std: numbers(&inverse_std),
                own: own.as_ref().map(|own| numbers(own)),
                columns: numbers(&samples.0),
            }
        };
        // SAFETY: as above.
        let pass = unsafe {
            LogRatio {
                shared,
                mean: numbers(&mean),
                constant: numbers(&constant),
                z: numbers_mut(&mut z),
                log_ratio: numbers_mut(&mut log_ratio),
            }
        };
        run_for(Features::detect(), pass);
        let ratio = log_ratio.exp();
        let mut terms = zeros(&[a, STATISTICS as i64 + u, b]);
        // SAFETY: as above; `terms` is new, too.
        let pass = unsafe {
            Terms {
                shared,
                clip: [1.0 - self.clip, 1.0 + self.clip].map(|limit| limit as f32),
                dual_clip: (self.dual_clip > 0.0).then_some(self.dual_clip as f32),
                scale: (-self.multiplier / batch as f64) as f32,
                log_ratio: numbers(&log_ratio),
                ratio: numbers(&ratio),
                z: numbers_mut(&mut z),
                terms: numbers_mut(&mut terms),
            }
        };
        run_for(Features::detect(), pass);
        let sums = terms.sum_dim_intlist(&[2i64][..], false, Kind::Float);
        let log_std = sums.narrow(1, STATISTICS as i64, u);
        let sums = sums.narrow(1, 0, STATISTICS as i64);
        let _ = sums.select(1, 0).g_mul_scalar_(-self.multiplier);
        let output = if self.squash_mean { Tensor::tanh_backward(&z, &mean) } else { z };
        ActorGradient { output, log_std, sums }
    }
}

/// What both passes over the actors' samples read.
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
    /// The factor of an action of an actor that counts.
    #[inline(always)]
    fn own(&self, index: usize) -> f32 {
        self.own.map_or(1.0, |own| own[index])
    }
}

/// z = (a − μ) / σ, and the logarithm of the ratio of probabilities.
struct LogRatio<'a> {
    shared: Shared<'a>,
    mean: &'a [f32],
    constant: &'a [f32],
    /// Out: `[A, U, B]`.
    z: &'a mut [f32],
    /// In: zeros; out: `[A, B]`.
    log_ratio: &'a mut [f32],
}

impl Loop for LogRatio<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { shared, mean, constant, z, log_ratio } = self;
        let Shared { actions: u, samples: b, inverse_std, columns, .. } = shared;
        for (actor, log_ratio) in log_ratio.chunks_exact_mut(b).enumerate() {
            let columns = &columns[actor * (u + 2) * b..][..(u + 2) * b];
            for action in 0..u {
                let index = actor * u + action;
                let (inverse, own) = (inverse_std[index], shared.own(index));
                let (mean, z) = (&mean[index * b..][..b], &mut z[index * b..][..b]);
                let taken = &columns[action * b..][..b];
                for i in 0..b {
                    z[i] = (taken[i] - mean[i]) * inverse * own;
                    log_ratio[i] += z[i] * z[i];
                }
            }
            let old = &columns[u * b..][..b];
            for i in 0..b {
                log_ratio[i] = log_ratio[i] * -0.5 - constant[actor] - old[i];
            }
        }
    }
}

/// What is summed over samples, and the gradient by the means.
struct Terms<'a> {
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
    /// `[A, 3 + U, B]`.
    terms: &'a mut [f32],
}

impl Loop for Terms<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { shared, clip, dual_clip, scale, log_ratio, ratio, z, terms } = self;
        let Shared { actions: u, samples: b, inverse_std, columns, .. } = shared;
        let mut by_log_prob = vec![0.0f32; b];
        let by_log_prob = &mut by_log_prob[..b];
        for (actor, terms) in terms.chunks_exact_mut((STATISTICS + u) * b).enumerate() {
            let (ratio, log_ratio) = (&ratio[actor * b..][..b], &log_ratio[actor * b..][..b]);
            let advantage = &columns[actor * (u + 2) * b..][(u + 1) * b..][..b];
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
                let index = actor * u + action;
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

impl CriticLoss {
    /// [`CriticLoss::gradient`] in a pass.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(super) fn gradient_in_a_pass(
        &self,
        value: &Tensor,
        samples: &CriticSamples,
        batch: i64,
    ) -> (Tensor, Tensor) {
        let (a, b) = value.size2().expect("[A, B]");
        let mut both = Tensor::zeros([2, a, b], (Kind::Float, Device::Cpu));
        assert!(are_apart(&[&both, value, &samples.0]), "fresh memory");
        // SAFETY: what is read is filled; what is written was made of zeros here and is apart. No other thread has a handle.
        let pass = unsafe {
            let (gradient, loss) = numbers_mut(&mut both).split_at_mut((a * b) as usize);
            ValueLoss {
                samples: b as usize,
                clip: (self.clip != 0.0).then_some(self.clip as f32),
                huber_delta: (self.huber_delta != 0.0).then_some(self.huber_delta as f32),
                scale: (self.coefficient / batch as f64) as f32,
                value: numbers(value),
                columns: numbers(&samples.0),
                gradient,
                loss,
            }
        };
        run_for(Features::detect(), pass);
        let sum = both.get(1).sum_dim_intlist(&[1i64][..], false, Kind::Float) * self.coefficient;
        (both.get(0), sum)
    }
}

/// The critics' losses and their gradients.
struct ValueLoss<'a> {
    samples: usize,
    clip: Option<f32>,
    huber_delta: Option<f32>,
    /// c / B.
    scale: f32,
    /// `[A, B]`.
    value: &'a [f32],
    /// `[A, 2, B]`.
    columns: &'a [f32],
    /// Out: `[A, B]`.
    gradient: &'a mut [f32],
    /// Out: `[A, B]`.
    loss: &'a mut [f32],
}

impl ValueLoss<'_> {
    /// The loss's derivative by the error.
    #[inline(always)]
    fn slope(huber_delta: Option<f32>, error: f32) -> f32 {
        huber_delta.map_or(error, |delta| clamp(error, [-delta, delta]))
    }

    /// The loss of an error.
    #[inline(always)]
    fn penalty(huber_delta: Option<f32>, error: f32) -> f32 {
        match huber_delta {
            None => error * error * 0.5,
            Some(_) => {
                let inner = Self::slope(huber_delta, error);
                inner * (error - inner * 0.5)
            }
        }
    }
}

impl Loop for ValueLoss<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { samples: b, clip, huber_delta, scale, value, columns, gradient, loss } = self;
        let rows = value.chunks_exact(b).zip(columns.chunks_exact(2 * b));
        let made = gradient.chunks_exact_mut(b).zip(loss.chunks_exact_mut(b));
        for ((value, columns), (gradient, loss)) in rows.zip(made) {
            let (old, target) = columns.split_at(b);
            for i in 0..b {
                let error = value[i] - target[i];
                let plain = Self::penalty(huber_delta, error);
                let slope = Self::slope(huber_delta, error);
                let Some(clip) = clip else {
                    (loss[i], gradient[i]) = (plain, slope * scale);
                    continue;
                };
                let change = value[i] - old[i];
                let small = clamp(change, [-clip, clip]);
                let limited = Self::penalty(huber_delta, old[i] + small - target[i]);
                let moves = (plain >= limited) | (small == change);
                loss[i] = maximum(plain, limited);
                gradient[i] = slope * f32::from(u8::from(moves)) * scale;
            }
        }
    }
}

/// `x` between two limits; NaN stays.
#[inline(always)]
fn clamp(x: f32, [low, high]: [f32; 2]) -> f32 {
    let x = if x < low { low } else { x };
    if x > high { high } else { x }
}

/// The smaller of two numbers; NaN if one is.
#[inline(always)]
fn minimum(a: f32, b: f32) -> f32 {
    let least = if a < b { a } else { b };
    if a.is_nan() { a } else { least }
}

/// The larger of two numbers; NaN if one is.
#[inline(always)]
fn maximum(a: f32, b: f32) -> f32 {
    let most = if a > b { a } else { b };
    if a.is_nan() { a } else { most }
}
