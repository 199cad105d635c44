//! The losses on a CPU: passes over the samples in plain Rust.
//!
//! Each number is made by the operations of the twin, in their order and each rounded, so the bits are the same. What libtorch has ways of its own for stays
//! libtorch's: exponentials, tanh and its derivative.

use tch::{Device, Kind, Tensor};

use super::sum::{TERMS, sum};
use super::{ActorLoss, CriticLoss, HALF_LN_TAU};
use crate::features::{Features, Loop, run_for};
use crate::memory::{are_apart, numbers, numbers_mut};

/// Of each agent what is summed over samples, before the gradients by deviations: surrogate, divergence, whether the ratio is clipped.
pub(crate) const STATISTICS: usize = 3;

/// Room for the actors' loss of a chunk.
#[derive(Debug)]
pub(crate) struct ActorPasses {
    /// A, U, B.
    size: [usize; 3],
    /// `[A, U]` each: the logarithm of the deviation in force, and the reciprocal deviation.
    log_std: Vec<f32>,
    inverse_std: Tensor,
    /// `[A, U, B]` each: tanh of the outputs, z, and the gradient by the outputs where tanh squashes them.
    mean: Tensor,
    z: Tensor,
    gradient: Tensor,
    /// `[A, B]` each: of the probabilities.
    log_ratio: Tensor,
    ratio: Tensor,
    /// `[3 + U, B]`, of the agent at hand.
    terms: Vec<f32>,
    by_log_prob: Vec<f32>,
    /// `[A, 3 + U]`: sums over samples of the statistics, and the gradient by the logarithm of the deviation, without entropy.
    sums: Vec<f32>,
}

impl Default for ActorPasses {
    fn default() -> Self {
        Self::new([0; 3])
    }
}

impl ActorPasses {
    fn new(size: [usize; 3]) -> Self {
        let [a, u, b] = size;
        let tensor = |shape: &[usize]| {
            let shape: Vec<i64> = shape.iter().map(|&size| size as i64).collect();
            Tensor::zeros(shape, (Kind::Float, Device::Cpu))
        };
        let all = || tensor(&[a, u, b]);
        Self {
            size,
            log_std: vec![0.0; a * u],
            inverse_std: tensor(&[a, u]),
            mean: all(),
            z: all(),
            gradient: all(),
            log_ratio: tensor(&[a, b]),
            ratio: tensor(&[a, b]),
            terms: vec![0.0; (STATISTICS + u) * b],
            by_log_prob: vec![0.0; b],
            sums: vec![0.0; a * (STATISTICS + u)],
        }
    }
}

impl ActorLoss {
    /// [`ActorLoss::gradient`] in passes: the gradient `[A, U, B]` by the networks' outputs, and `[A, 3 + U]` sums over samples: the statistics, and the gradient
    /// by the logarithm of the deviation. `parameter` and `own` are `[A, U]`, `columns` `[A, U + 2, B]`.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(crate) fn gradient_in_passes<'p>(
        &self,
        passes: &'p mut ActorPasses,
        output: &Tensor,
        parameter: &[f32],
        own: Option<&[f32]>,
        columns: &[f32],
        batch: usize,
    ) -> (&'p Tensor, &'p [f32]) {
        let (a, u, b) = output.size3().expect("[A, U, B]");
        let size @ [a, u, b] = [a, u, b].map(|size| size as usize);
        assert_eq!((parameter.len(), columns.len()), (a * u, a * (u + 2) * b), "other samples");
        if passes.size != size {
            *passes = ActorPasses::new(size);
        }
        let ActorPasses { log_std, inverse_std, mean, z, gradient, log_ratio, ratio, .. } = passes;
        let floor = self.min_log_std as f32;
        for (log_std, &parameter) in log_std.iter_mut().zip(parameter) {
            *log_std = if parameter < floor { floor } else { parameter };
        }
        // SAFETY: made of zeros by the passes, which lend them to nobody else.
        let negative: &mut [f32] = unsafe { numbers_mut(inverse_std) };
        negative.iter_mut().zip(&*log_std).for_each(|(negative, log_std)| *negative = -log_std);
        let _ = inverse_std.exp_();
        if self.squash_mean {
            let _ = output.tanh_out(mean);
        }
        let mean = if self.squash_mean { &*mean } else { output };
        assert!(are_apart(&[z, log_ratio, mean]), "outputs lie in memory of the passes");
        // SAFETY: outputs are the caller's, filled and apart from the passes' tensors, which were made of zeros. libtorch does nothing until the pass has ended.
        let (shared, pass) = unsafe {
            let shared = Shared {
                actions: u,
                samples: b,
                inverse_std: numbers(inverse_std),
                own,
                columns,
            };
            let pass = LogRatio {
                shared,
                mean: numbers(mean),
                log_std,
                z: numbers_mut(z),
                log_ratio: numbers_mut(log_ratio),
                aside: &mut passes.by_log_prob,
            };
            (shared, pass)
        };
        run_for(Features::detect(), pass);
        let _ = log_ratio.exp_out(ratio);
        // SAFETY: as above.
        let pass = unsafe {
            Terms {
                shared,
                clip: [1.0 - self.clip, 1.0 + self.clip].map(|limit| limit as f32),
                dual_clip: (self.dual_clip > 0.0).then_some(self.dual_clip as f32),
                multiplier: self.multiplier as f32,
                scale: (-self.multiplier / batch as f64) as f32,
                log_ratio: numbers(log_ratio),
                ratio: numbers(ratio),
                z: numbers_mut(z),
                by_log_prob: &mut passes.by_log_prob,
                terms: &mut passes.terms,
                sums: &mut passes.sums,
            }
        };
        run_for(Features::detect(), pass);
        if self.squash_mean {
            let _ = Tensor::tanh_backward_grad_input(gradient, z, mean);
            (&passes.gradient, &passes.sums)
        } else {
            (&passes.z, &passes.sums)
        }
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
    /// `[A, U]`.
    log_std: &'a [f32],
    /// Out: `[A, U, B]`.
    z: &'a mut [f32],
    /// Out: `[A, B]`.
    log_ratio: &'a mut [f32],
    /// `[B]`: sums over actions that are put aside.
    aside: &'a mut [f32],
}

impl LogRatio<'_> {
    /// Σ ln σ + U ½ ln 2π over an agent's actions that move something.
    #[inline(always)]
    fn constant(&self, agent: usize) -> f32 {
        let u = self.shared.actions;
        let log_std = &self.log_std[agent * u..][..u];
        match self.shared.own {
            None => sum(log_std) + (HALF_LN_TAU * u as f64) as f32,
            Some(own) => {
                let half = HALF_LN_TAU as f32;
                let own = &own[agent * u..][..u];
                let terms: Vec<f32> =
                    log_std.iter().zip(own).map(|(log_std, own)| (log_std + half) * own).collect();
                sum(&terms)
            }
        }
    }
}

impl Loop for LogRatio<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Shared { actions: u, samples: b, inverse_std, columns, .. } = self.shared;
        for agent in 0..self.log_ratio.len() / b.max(1) {
            let constant = self.constant(agent);
            let log_ratio = &mut self.log_ratio[agent * b..][..b];
            let aside = &mut self.aside[..b];
            let columns = &columns[agent * (u + 2) * b..][..(u + 2) * b];
            log_ratio.fill(0.0);
            aside.fill(0.0);
            for action in 0..u {
                let index = agent * u + action;
                let (inverse, own) = (inverse_std[index], self.shared.own(index));
                let (mean, z) = (&self.mean[index * b..][..b], &mut self.z[index * b..][..b]);
                let taken = &columns[action * b..][..b];
                for i in 0..b {
                    z[i] = (taken[i] - mean[i]) * inverse * own;
                    log_ratio[i] += z[i] * z[i];
                }
                if (action + 1).is_multiple_of(TERMS) {
                    for i in 0..b {
                        aside[i] += std::mem::take(&mut log_ratio[i]);
                    }
                }
            }
            let old = &columns[u * b..][..b];
            for i in 0..b {
                log_ratio[i] = (log_ratio[i] + aside[i]) * -0.5 - constant - old[i];
            }
        }
    }
}

/// What is summed over samples, and the gradient by the means.
struct Terms<'a> {
    shared: Shared<'a>,
    clip: [f32; 2],
    dual_clip: Option<f32>,
    multiplier: f32,
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
    /// `[3 + U, B]`: of the agent at hand.
    terms: &'a mut [f32],
    /// Out: `[A, 3 + U]`.
    sums: &'a mut [f32],
}

impl Loop for Terms<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { shared, clip, dual_clip, multiplier, scale, log_ratio, ratio, .. } = self;
        let Shared { actions: u, samples: b, inverse_std, columns, .. } = shared;
        let (z, by_log_prob) = (self.z, &mut self.by_log_prob[..b]);
        for (agent, sums) in self.sums.chunks_exact_mut(STATISTICS + u).enumerate() {
            let (ratio, log_ratio) = (&ratio[agent * b..][..b], &log_ratio[agent * b..][..b]);
            let advantage = &columns[agent * (u + 2) * b..][(u + 1) * b..][..b];
            let (surrogate, rest) = self.terms.split_at_mut(b);
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
            for (index, sum_of_term) in sums.iter_mut().enumerate() {
                *sum_of_term = sum(&self.terms[index * b..][..b]);
            }
            sums[0] *= -multiplier;
        }
    }
}

/// Room for the critics' loss of a chunk.
#[derive(Debug)]
pub(crate) struct CriticPasses {
    /// As the outputs: `[C, A / C, B]`.
    gradient: Tensor,
    /// `[B]`, of the agent at hand.
    loss: Vec<f32>,
    /// `[A]`.
    sums: Vec<f32>,
}

impl Default for CriticPasses {
    fn default() -> Self {
        let gradient = Tensor::zeros([0, 0, 0], (Kind::Float, Device::Cpu));
        Self { gradient, loss: Vec::new(), sums: Vec::new() }
    }
}

impl CriticLoss {
    /// [`CriticLoss::gradient`] in a pass: the gradient by the outputs `[C, A / C, B]` of the mean loss over a critic's agents, and the sum of the losses
    /// over samples of each agent. Critic c is that of the agents c, c + C, c + 2C … `columns` is `[A, 2, B]`.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(crate) fn gradient_in_a_pass<'p>(
        &self,
        passes: &'p mut CriticPasses,
        output: &Tensor,
        columns: &[f32],
        batch: usize,
    ) -> (&'p Tensor, &'p [f32]) {
        let (critics, each, b) = output.size3().expect("[C, A / C, B]");
        let size = [critics, each, b];
        let [critics, each, b] = size.map(|size| size as usize);
        assert_eq!(columns.len(), critics * each * 2 * b, "other samples");
        if passes.gradient.size() != size {
            passes.gradient = Tensor::zeros(size, (Kind::Float, Device::Cpu));
            passes.loss = vec![0.0; b];
            passes.sums = vec![0.0; critics * each];
        }
        assert!(are_apart(&[&passes.gradient, output]), "outputs lie in memory of the passes");
        // SAFETY: outputs are the caller's, filled and apart from the gradient, which was made of zeros. libtorch does nothing until the pass has ended.
        let pass = unsafe {
            ValueLoss {
                critics,
                each,
                clip: (self.clip != 0.0).then_some(self.clip as f32),
                huber_delta: (self.huber_delta != 0.0).then_some(self.huber_delta as f32),
                scale: (self.coefficient / batch as f64) as f32,
                coefficient: self.coefficient as f32,
                output: numbers(output),
                columns,
                gradient: numbers_mut(&mut passes.gradient),
                loss: &mut passes.loss,
                sums: &mut passes.sums,
            }
        };
        run_for(Features::detect(), pass);
        (&passes.gradient, &passes.sums)
    }
}

/// The critics' losses and their gradients.
struct ValueLoss<'a> {
    /// C.
    critics: usize,
    /// A / C.
    each: usize,
    clip: Option<f32>,
    huber_delta: Option<f32>,
    /// c / B.
    scale: f32,
    /// c.
    coefficient: f32,
    /// `[C, A / C, B]`.
    output: &'a [f32],
    /// `[A, 2, B]`.
    columns: &'a [f32],
    /// Out: `[C, A / C, B]`.
    gradient: &'a mut [f32],
    /// `[B]`, of the agent at hand.
    loss: &'a mut [f32],
    /// Out: `[A]`.
    sums: &'a mut [f32],
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
        let Self { critics, each, clip, huber_delta, scale, output, columns, .. } = self;
        let (gradient, loss) = (self.gradient, self.loss);
        let b = loss.len();
        for (agent, sum_of_losses) in self.sums.iter_mut().enumerate() {
            let at = (agent % critics * each + agent / critics) * b;
            let (value, gradient) = (&output[at..][..b], &mut gradient[at..][..b]);
            let (old, target) = columns[agent * 2 * b..][..2 * b].split_at(b);
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
            if each > 1 {
                gradient.iter_mut().for_each(|gradient| *gradient /= each as f32);
            }
            *sum_of_losses = sum(loss) * self.coefficient;
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
