//! Adam over the stacked parameters of all agents.
//!
//! Kingma and Ba, "Adam: a method for stochastic optimization", ICLR 2015, algorithm 1, in the form
//! that deep-learning libraries share:
//!
//! ```text
//! m ← β₁ m + (1 − β₁) g        v ← β₂ v + (1 − β₂) g²
//! θ ← θ − lr / (1 − β₁ᵗ) · m / (√v / √(1 − β₂ᵗ) + ε)
//! ```
//!
//! Own code, because libtorch's binding cannot save an optimiser's moments. Every agent counts its
//! own steps: early stopping may hold one back.

use std::ops::Range;

use tch::{Device, Tensor};

use crate::features::{Features, Loop, mul_add, run_for};
use crate::memory::{are_apart, numbers, numbers_mut};

/// β₁, β₂, ε.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamOptions {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// ε of the denominator.
    pub epsilon: f64,
}

/// A gradient and what it counts for.
#[derive(Debug)]
pub struct ScaledGradient<'a> {
    /// `[A, P]`.
    pub sum: &'a Tensor,
    /// One factor an agent.
    pub factors: &'a [f32],
}

/// Moments and step counts.
#[derive(Debug)]
pub struct Adam {
    /// `[A, P]`: first moment.
    pub m: Tensor,
    /// `[A, P]`: second moment.
    pub v: Tensor,
    /// Steps that each agent has made.
    pub steps: Vec<i64>,
}

impl Adam {
    /// Zero moments beside `flat` `[A, P]`.
    pub fn new(flat: &Tensor) -> Self {
        Self { m: flat.zeros_like(), v: flat.zeros_like(), steps: vec![0; flat.size()[0] as usize] }
    }

    /// One step of `flat` against `gradient`, both `[A, P]`, for the agents that are `active`, each at
    /// its own rate, in those of its columns that are learned. `scratch` may be overwritten.
    #[expect(clippy::too_many_arguments, reason = "what a step of Adam is of")]
    pub fn step(
        &mut self,
        options: &AdamOptions,
        learning_rates: &[f64],
        flat: &Tensor,
        gradient: &ScaledGradient<'_>,
        scratch: &Tensor,
        active: &[bool],
        columns: impl Fn(usize) -> Range<i64>,
    ) {
        let ScaledGradient { sum: gradient, factors } = *gradient;
        debug_assert_eq!(flat.size(), gradient.size());
        debug_assert_eq!(factors.len(), self.steps.len());
        for (count, _) in self.steps.iter_mut().zip(active).filter(|(_, active)| **active) {
            *count += 1;
        }
        let rates = |agent: usize| {
            let step = self.steps[agent] as f64;
            Rates {
                first: 1.0 - options.beta1,
                second: 1.0 - options.beta2,
                correction: 1.0 / (1.0 - options.beta2.powf(step)).sqrt(),
                epsilon: options.epsilon,
                length: learning_rates[agent] / (1.0 - options.beta1.powf(step)),
            }
        };
        let agents = (0..self.steps.len()).filter(|&agent| active[agent]);
        if flat.device() == Device::Cpu {
            // A pass on a CPU wants its numbers side by side.
            let rows = agents.map(|agent| (agent, columns(agent), rates(agent), factors[agent]));
            step_in_passes(rows, [flat, &self.m, &self.v, gradient]);
            return;
        }
        // A GPU wants few operations: neighbours who do the same step together.
        let alike = |&one: &usize, &next: &usize| {
            next == one + 1
                && self.steps[one] == self.steps[next]
                && learning_rates[one] == learning_rates[next]
                && columns(one) == columns(next)
        };
        let agents: Vec<usize> = agents.collect();
        let factors = Tensor::from_slice(factors).to_device(flat.device()).unsqueeze(1);
        for together in agents.chunk_by(alike) {
            let (first, columns) = (together[0], columns(together[0]));
            let part = |tensor: &Tensor| {
                let rows = tensor.narrow(0, first as i64, together.len() as i64);
                rows.narrow(1, columns.start, columns.end - columns.start)
            };
            let factors = factors.narrow(0, first as i64, together.len() as i64);
            let parts = [flat, &self.m, &self.v, gradient].map(part);
            step_by_operations(&rates(first), &factors, parts, &part(scratch));
        }
    }
}

/// Factors of a step.
#[derive(Clone, Copy)]
struct Rates {
    /// 1 − β₁.
    first: f64,
    /// 1 − β₂.
    second: f64,
    /// 1 / √(1 − β₂ᵗ).
    correction: f64,
    epsilon: f64,
    /// lr / (1 − β₁ᵗ).
    length: f64,
}

/// The step in libtorch's operations, of θ, m, v and g, whose rows count by `factors` `[A, 1]`.
fn step_by_operations(rates: &Rates, factors: &Tensor, parts: [Tensor; 4], scratch: &Tensor) {
    let [mut flat, mut m, mut v, g] = parts;
    let mut denominator = scratch.shallow_clone();
    let _ = g.multiply_out(&denominator, factors);
    let _ = m.lerp_(scratch, rates.first);
    let _ = denominator.square_();
    let _ = v.lerp_(scratch, rates.second);
    let _ = v.sqrt_out(&denominator);
    let _ = denominator.g_mul_scalar_(rates.correction);
    let _ = denominator.g_add_scalar_(rates.epsilon);
    let _ = m.divide_out(&denominator, &denominator.shallow_clone());
    let _ = denominator.g_mul_scalar_(rates.length);
    let _ = flat.g_sub_(&denominator);
}

/// The same in one pass over memory a row, which is what a step costs on a CPU: of the rows of `[A, P]` θ, m, v and g the columns that are learned, with
/// their rates and factors.
///
/// # Panics
/// If two of the tensors share memory.
#[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
fn step_in_passes(
    rows: impl Iterator<Item = (usize, Range<i64>, Rates, f32)>,
    [flat, m, v, g]: [&Tensor; 4],
) {
    assert!(are_apart(&[flat, m, v, g]), "parameters, moments and gradient share memory");
    let len = flat.size()[1] as usize;
    let [mut flat, mut m, mut v] = [flat, m, v].map(Tensor::shallow_clone);
    // SAFETY: parameters, moments and gradient are filled and apart. Nobody else uses these rows
    // meanwhile: an update has the training state to itself, and of groups of actors that are updated at the same
    // time each has rows of its own.
    let (flat, m, v, g): (&mut [f32], &mut [f32], &mut [f32], &[f32]) =
        unsafe { (numbers_mut(&mut flat), numbers_mut(&mut m), numbers_mut(&mut v), numbers(g)) };
    for (row, columns, rates, factor) in rows {
        let columns = row * len + columns.start as usize..row * len + columns.end as usize;
        let pass = Pass {
            factor,
            rates: [rates.first, rates.second, rates.correction, rates.epsilon, rates.length]
                .map(|rate| rate as f32),
            flat: &mut flat[columns.clone()],
            m: &mut m[columns.clone()],
            v: &mut v[columns.clone()],
            g: &g[columns],
        };
        run_for(Features::detect(), pass);
    }
}

/// The arguments of a row of [`step_in_passes`].
struct Pass<'a> {
    factor: f32,
    rates: [f32; 5],
    flat: &'a mut [f32],
    m: &'a mut [f32],
    v: &'a mut [f32],
    g: &'a [f32],
}

impl Loop for Pass<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { factor, rates: [first, second, correction, epsilon, length], .. } = self;
        let Self { flat, m, v, g, .. } = self;
        for (((flat, m), v), &g) in flat.iter_mut().zip(m).zip(v).zip(g) {
            let g = g * factor;
            *m = mul_add::<FMA>(first, g - *m, *m);
            *v = mul_add::<FMA>(second, mul_add::<FMA>(g, g, -*v), *v);
            let denominator = mul_add::<FMA>(v.sqrt(), correction, epsilon);
            *flat -= length * (*m / denominator);
        }
    }
}

/// What gradients of these norms are to be multiplied with, so that none exceeds `max_norm`; 0 turns that off.
pub fn clip_factors(norms: &[f64], max_norm: f64) -> Vec<f32> {
    let factor = |&norm: &f64| {
        if max_norm > 0.0 { (max_norm / (norm + 1e-6)).min(1.0) as f32 } else { 1.0 }
    };
    norms.iter().map(factor).collect()
}

#[cfg(test)]
mod tests {
    use tch::nn::{self, OptimizerConfig};
    use tch::{Device, Kind};

    use super::*;

    const OPTIONS: AdamOptions = AdamOptions { beta1: 0.9, beta2: 0.999, epsilon: 1e-5 };

    /// A gradient that counts for what it is.
    fn whole(sum: &Tensor) -> ScaledGradient<'_> {
        ScaledGradient { sum, factors: &[1.0; 2][..sum.size()[0] as usize] }
    }

    #[test]
    fn follows_libtorchs_own_adam_step_by_step() {
        tch::manual_seed(3);
        let start = Tensor::randn([2, 50], (Kind::Float, Device::Cpu));
        let ours = start.copy();
        let mut adam = Adam::new(&ours);
        let scratch = ours.zeros_like();
        let store = nn::VarStore::new(Device::Cpu);
        let mut theirs = store.root().var_copy("x", &start);
        let mut optimizer =
            nn::Adam { beta1: 0.9, beta2: 0.999, wd: 0.0, eps: 1e-5, amsgrad: false }
                .build(&store, 0.01)
                .expect("valid options");
        for step in 0..20 {
            // The same gradient for both: of a quadratic that changes from step to step.
            let target = Tensor::randn([2, 50], (Kind::Float, Device::Cpu));
            theirs.zero_grad();
            ((&theirs - &target).square().sum(Kind::Float) * 0.5).backward();
            let gradient = theirs.grad().copy();
            adam.step(
                &OPTIONS,
                &[0.01; 2],
                &ours,
                &whole(&gradient),
                &scratch,
                &[true, true],
                |_| 0..50,
            );
            optimizer.step();
            let error = (&ours - theirs.detach()).abs().max().double_value(&[]);
            // A few roundings of values of order 1 a step, 2⁻²⁴ each.
            assert!(error < 4.0 * (step + 1) as f64 * 2f64.powi(-24), "step {step}: {error}");
        }
    }

    #[test]
    fn one_pass_is_the_operations() {
        tch::manual_seed(4);
        let normal = || Tensor::randn([3, 1001], (Kind::Float, Device::Cpu));
        let drawn = [normal(), normal(), normal().square(), normal()];
        // Copies: other tests draw from the same generator meanwhile.
        let parts = || drawn.each_ref().map(Tensor::copy);
        let rates =
            Rates { first: 0.1, second: 0.001, correction: 3.0, epsilon: 1e-5, length: 0.01 };
        let (ours, theirs) = (parts(), parts());
        // Some of the columns: operations take rows with gaps between them.
        let learned = |tensor: &Tensor| tensor.narrow(1, 7, 900);
        let factors = [0.7, 1.0, 0.3];
        let rows = factors.into_iter().enumerate();
        let rows = rows.map(|(row, factor)| (row, 7..907, rates, factor));
        step_in_passes(rows, ours.each_ref());
        let scratch = learned(&theirs[0].zeros_like());
        let factors = Tensor::from_slice(&factors).view([3, 1]);
        step_by_operations(&rates, &factors, theirs.each_ref().map(learned), &scratch);
        for (ours, theirs) in ours.iter().zip(&theirs) {
            let error = (ours - theirs).abs().max().double_value(&[]);
            // A few roundings of values of order 1, 2⁻²⁴ each; small denominators multiply them.
            assert!(error < 1e-5, "{error}");
        }
    }

    #[test]
    #[should_panic(expected = "share memory")]
    fn a_gradient_that_is_the_parameters_is_refused() {
        let flat = Tensor::ones([1, 3], (Kind::Float, Device::Cpu));
        let scratch = flat.zeros_like();
        Adam::new(&flat).step(&OPTIONS, &[0.1], &flat, &whole(&flat), &scratch, &[true], |_| 0..3);
    }

    #[test]
    fn a_gradient_counts_by_its_factor() {
        let sum = Tensor::from_slice(&[4.0f32, -8.0, 4.0, -8.0]).view([2, 2]);
        let step = |sum: &Tensor, factors: &[f32]| {
            let flat = Tensor::zeros([2, 2], (Kind::Float, Device::Cpu));
            let (mut adam, scratch) = (Adam::new(&flat), flat.zeros_like());
            let gradient = ScaledGradient { sum, factors };
            adam.step(&OPTIONS, &[0.1; 2], &flat, &gradient, &scratch, &[true; 2], |_| 0..2);
            Vec::<f32>::try_from(adam.m.view([-1])).expect("four numbers")
        };
        let scaled = step(&sum, &[0.25, 0.5]);
        let expected =
            step(&Tensor::from_slice(&[1.0f32, -2.0, 2.0, -4.0]).view([2, 2]), &[1.0; 2]);
        assert_eq!(scaled, expected);
        assert_ne!(scaled, step(&sum, &[1.0; 2]));
    }

    #[test]
    fn an_inactive_agent_stays_as_it_is_and_resumes_with_its_own_count() {
        let flat = Tensor::ones([2, 3], (Kind::Float, Device::Cpu));
        let gradient = flat.copy();
        let scratch = flat.zeros_like();
        let mut adam = Adam::new(&flat);
        adam.step(&OPTIONS, &[0.1; 2], &flat, &whole(&gradient), &scratch, &[true, false], |_| {
            0..3
        });
        assert_eq!(adam.steps, [1, 0]);
        assert_eq!(flat.get(1), Tensor::ones([3], (Kind::Float, Device::Cpu)));
        assert_eq!(adam.v.get(1).double_value(&[0]), 0.0);
        let once = flat.get(0).copy();
        adam.step(&OPTIONS, &[0.1; 2], &flat, &whole(&gradient), &scratch, &[false, true], |_| {
            0..3
        });
        assert_eq!(flat.get(1), once, "its first step is what the other's was");
        assert_eq!(adam.steps, [1, 1]);
    }

    #[test]
    fn columns_that_are_not_learned_stay_as_they_are() {
        let flat = Tensor::ones([2, 4], (Kind::Float, Device::Cpu));
        let (gradient, scratch) = (flat.copy(), flat.zeros_like());
        let columns = |row| if row == 0 { 0..4 } else { 1..3 };
        let mut adam = Adam::new(&flat);
        adam.step(&OPTIONS, &[0.1; 2], &flat, &whole(&gradient), &scratch, &[true; 2], columns);
        let moved = flat.lt(1.0).to_kind(Kind::Float);
        let expected = [1.0f32, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0];
        assert_eq!(moved.view([-1]), Tensor::from_slice(&expected));
    }

    #[test]
    fn agents_step_at_their_own_rates() {
        let flat = Tensor::zeros([2, 3], (Kind::Float, Device::Cpu));
        let gradient = flat.ones_like();
        let mut adam = Adam::new(&flat);
        let (rates, scratch) = ([0.1, 0.025], flat.zeros_like());
        adam.step(&OPTIONS, &rates, &flat, &whole(&gradient), &scratch, &[true, true], |_| 0..3);
        // A first step is as long as the rate, but for ε.
        for (agent, rate) in [(0, 0.1), (1, 0.025)] {
            assert!((flat.double_value(&[agent, 2]) + rate).abs() < 1e-5 * rate + 1e-6);
        }
    }

    #[test]
    fn only_what_is_above_the_limit_is_scaled() {
        let close = |factor: f32, expected: f64| (f64::from(factor) - expected).abs() < 1e-6;
        let factors = clip_factors(&[5.0, 0.5], 1.0);
        assert!(close(factors[0], 0.2) && factors[1] == 1.0, "{factors:?}");
        assert_eq!(clip_factors(&[5.0, 0.5], 0.0), [1.0, 1.0]);
    }
}
