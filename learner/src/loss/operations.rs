//! The losses in libtorch's operations.
//!
//! Letters as in [`super`].

use tch::{Kind, Tensor};

/// ½ ln 2π.
pub(super) const HALF_LN_TAU: f64 = 0.918_938_533_204_672_8;

/// What the actors' loss needs of a configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActorLoss {
    /// Clip range of the probability ratio.
    pub clip: f64,
    /// Largest ratio that counts where the advantage is negative, above 1 + `clip`; 0 for no such limit.
    pub dual_clip: f64,
    /// Factor on the surrogate.
    pub multiplier: f64,
    /// Weight of the entropy bonus.
    pub entropy_coefficient: f64,
    /// Whether tanh squashes the mean.
    pub squash_mean: bool,
    /// Floor of the logarithm of the deviation.
    pub min_log_std: f64,
}

/// Samples of the actors' loss, `[A, U + 2, B]`.
#[derive(Debug)]
pub struct ActorSamples(pub Tensor);

impl ActorSamples {
    /// U.
    fn actions(&self) -> i64 {
        self.0.size()[1] - 2
    }

    /// `[A, U, B]`: actions as they were sampled.
    fn action(&self) -> Tensor {
        self.0.narrow(1, 0, self.actions())
    }

    /// `[A, B]`: their log-probability densities at the time.
    fn old_log_prob(&self) -> Tensor {
        self.0.select(1, self.actions())
    }

    /// `[A, B]`: advantages.
    fn advantage(&self) -> Tensor {
        self.0.select(1, self.actions() + 1)
    }
}

/// Samples of the critics' loss, `[A, 2, B]`, in normalised units.
#[derive(Debug)]
pub struct CriticSamples(pub Tensor);

impl CriticSamples {
    /// `[A, B]`: what critics predicted at the time.
    fn old_value(&self) -> Tensor {
        self.0.select(1, 0)
    }

    /// `[A, B]`: returns.
    fn target(&self) -> Tensor {
        self.0.select(1, 1)
    }
}

/// What a chunk adds to the actors' gradient and statistics.
#[derive(Debug)]
pub struct ActorGradient {
    /// `[A, U, B]`: gradient of the loss by the networks' outputs.
    pub output: Tensor,
    /// `[A, U]`: gradient of the loss by the logarithm of the deviation, without entropy.
    pub log_std: Tensor,
    /// `[A, 3]`: sums over samples of the surrogate loss, of the KL estimator k3 and of the
    /// clipped ratios.
    pub sums: Tensor,
}

impl ActorLoss {
    /// Brings the parameter `[A, U]` back to its floor after a step, in place. Adam's momentum goes on where the
    /// gradient has ended, and from below the floor, where there is none, nothing would lead back. States
    /// that were saved before this was done may hold less; for them the parameter is floored where it is read, too.
    pub fn project(&self, parameter: &Tensor) {
        let _ = parameter.shallow_clone().clamp_min_(self.min_log_std);
    }

    /// The logarithm of the deviation in force: the parameter, floored.
    pub fn log_std(&self, parameter: &Tensor) -> Tensor {
        parameter.clamp_min(self.min_log_std)
    }

    /// Loss and gradient of a chunk. `output` `[A, U, B]` is the networks', `parameter` `[A, U]` the
    /// unfloored logarithm of the deviation, `batch` the number of samples of the mini-batch.
    pub fn gradient(
        &self,
        output: &Tensor,
        parameter: &Tensor,
        own: Option<&Tensor>,
        samples: &ActorSamples,
        batch: i64,
    ) -> ActorGradient {
        let (old_log_prob, advantage) = (samples.old_log_prob(), samples.advantage());
        let actions = &[1i64][..];
        let log_std = self.log_std(parameter);
        let inverse_std = log_std.neg().exp().unsqueeze(2);
        let mean = if self.squash_mean { output.tanh() } else { output.shallow_clone() };
        // z = (a − μ) / σ; ln p = −½ Σ z² − Σ ln σ − U ½ ln 2π.
        let mut z = (&samples.action() - &mean).g_mul_(&inverse_std);
        if let Some(own) = own {
            z = z.g_mul_(&own.unsqueeze(2));
        }
        let z2 = z.square();
        let sum_of = |x: &Tensor| x.sum_dim_intlist(actions, true, Kind::Float);
        let constant = match own {
            None => sum_of(&log_std) + HALF_LN_TAU * output.size()[1] as f64,
            Some(own) => sum_of(&((log_std + HALF_LN_TAU) * own)),
        };
        let log_prob = z2.sum_dim_intlist(actions, false, Kind::Float) * -0.5 - constant;
        let log_ratio = log_prob - old_log_prob;
        let ratio = log_ratio.exp();
        let clipped = ratio.clamp(1.0 - self.clip, 1.0 + self.clip);
        let plain = &ratio * &advantage;
        let limited = &clipped * &advantage;
        // min(plain, limited) is plain unless clipping lowers it; only then is it constant.
        let mut active = plain.le_tensor(&limited);
        let mut surrogate = plain.minimum(&limited);
        if self.dual_clip > 0.0 {
            // c · A where A is negative; elsewhere 0, which a surrogate of A ≥ 0 is never below.
            let least = (&advantage * self.dual_clip).clamp_max(0.0);
            active = active.logical_and(&plain.ge_tensor(&least));
            surrogate = surrogate.maximum(&least);
        }
        // k3 of Schulman, "Approximating KL divergence", 2020: (r − 1) − ln r.
        let kl = (&ratio - 1.0) - log_ratio;
        let outside = ratio.ne_tensor(&clipped);
        let row = &[1i64][..];
        let sum = |x: &Tensor| x.sum_dim_intlist(row, false, Kind::Float);
        let sums = Tensor::stack(&[sum(&surrogate) * -self.multiplier, sum(&kl), sum(&outside)], 1);
        // dL/d ln p = −k/B · A r where the surrogate moves, 0 elsewhere.
        let scale = -self.multiplier / batch as f64;
        let d_log_prob = (plain * active * scale).unsqueeze(1);
        // d ln p/dμ = z/σ; d ln p/d ln σ = z² − 1.
        let by_log_std = match own {
            None => z2 - 1.0,
            Some(own) => z2 - own.unsqueeze(2),
        };
        let log_std_gradient =
            (&d_log_prob * by_log_std).sum_dim_intlist(&[2i64][..], false, Kind::Float);
        let mut output_gradient = z.g_mul_(&inverse_std).g_mul_(&d_log_prob);
        if self.squash_mean {
            output_gradient = Tensor::tanh_backward(&output_gradient, &mean);
        }
        ActorGradient { output: output_gradient, log_std: log_std_gradient, sums }
    }

    /// Completes the gradient `[A, U]` by the log-deviation parameter, once a mini-batch: adds the
    /// entropy bonus, −c · d Σ ln σ / d ln σ = −c, and lets nothing through below the floor.
    pub fn finish_log_std(
        &self,
        gradient: &Tensor,
        parameter: &Tensor,
        own: Option<&Tensor>,
    ) -> Tensor {
        let gradient = (gradient - self.entropy_coefficient) * parameter.ge(self.min_log_std);
        own.map_or_else(|| gradient.shallow_clone(), |own| &gradient * own)
    }

    /// Entropy `[A]` of the action distribution (nats): Σ (ln σ + ½ ln 2πe).
    pub fn entropy(&self, parameter: &Tensor, own: Option<&Tensor>) -> Tensor {
        let entropy = self.log_std(parameter) + (HALF_LN_TAU + 0.5);
        let entropy = own.map_or_else(|| entropy.shallow_clone(), |own| &entropy * own);
        entropy.sum_dim_intlist(&[1i64][..], false, Kind::Float)
    }
}

/// What the critics' loss needs of a configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CriticLoss {
    /// Clip range around the old prediction; 0 turns clipping off.
    pub clip: f64,
    /// δ of the Huber loss; 0 means the squared error.
    pub huber_delta: f64,
    /// Weight of the loss.
    pub coefficient: f64,
}

impl CriticLoss {
    /// ½ e² up to δ, linear beyond (Huber 1964).
    fn penalty(&self, error: &Tensor) -> Tensor {
        if self.huber_delta == 0.0 {
            return error.square() * 0.5;
        }
        let inner = error.clamp(-self.huber_delta, self.huber_delta);
        // δ|e| − ½δ² = c (e − ½c) with c = clamp(e, ±δ); inside, c = e gives ½e².
        let half = &inner * 0.5;
        inner * (error - half)
    }

    /// Loss and gradient of a chunk: the gradient `[A, B]` by the predictions and the sum `[A]` of
    /// the losses. `value` is `[A, B]`, in normalised units.
    pub fn gradient(
        &self,
        value: &Tensor,
        samples: &CriticSamples,
        batch: i64,
    ) -> (Tensor, Tensor) {
        let (old_value, target) = (&samples.old_value(), &samples.target());
        let slope = |error: &Tensor| {
            if self.huber_delta == 0.0 {
                error.shallow_clone()
            } else {
                error.clamp(-self.huber_delta, self.huber_delta)
            }
        };
        let scale = self.coefficient / batch as f64;
        let row = &[1i64][..];
        let error = value - target;
        let plain = self.penalty(&error);
        if self.clip == 0.0 {
            let sum = plain.sum_dim_intlist(row, false, Kind::Float) * self.coefficient;
            return (slope(&error) * scale, sum);
        }
        let change = value - old_value;
        let small = change.clamp(-self.clip, self.clip);
        let clipped_error = old_value + &small - target;
        let limited = self.penalty(&clipped_error);
        let sum =
            plain.maximum(&limited).sum_dim_intlist(row, false, Kind::Float) * self.coefficient;
        // The larger of the two counts; the clipped one moves only inside its range, where both are
        // the same.
        let moves = plain.ge_tensor(&limited).logical_or(&small.eq_tensor(&change));
        (slope(&error) * moves * scale, sum)
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::loss::{ActorRoom, CriticRoom};

    fn random(seed: i64, shape: &[i64]) -> Tensor {
        tch::manual_seed(seed);
        Tensor::randn(shape, (Kind::Double, Device::Cpu))
    }

    /// With a floor below which some deviations lie.
    fn options(squash_mean: bool, dual_clip: f64) -> ActorLoss {
        ActorLoss {
            clip: 0.2,
            dual_clip,
            multiplier: 3.0,
            entropy_coefficient: 0.05,
            squash_mean,
            min_log_std: -0.5,
        }
    }

    /// The loss as its definition says, for libtorch to differentiate.
    fn actor_loss(
        l: &ActorLoss,
        output: &Tensor,
        parameter: &Tensor,
        own: Option<&Tensor>,
        s: &ActorSamples,
    ) -> Tensor {
        let own = own.map_or_else(|| parameter.ones_like(), Tensor::shallow_clone).unsqueeze(2);
        let mean = if l.squash_mean { output.tanh() } else { output.shallow_clone() };
        let log_std = parameter.clamp_min(l.min_log_std).unsqueeze(2);
        let (old_log_prob, advantage) = (s.old_log_prob(), s.advantage());
        let z = (&s.action() - mean) / log_std.exp();
        let density = (z.square() * -0.5 - &log_std - HALF_LN_TAU) * &own;
        let ratio = (density.sum_dim_intlist(&[1i64][..], false, None) - old_log_prob).exp();
        let clipped = ratio.clamp(1.0 - l.clip, 1.0 + l.clip);
        let mut surrogate = (ratio * &advantage).minimum(&(clipped * &advantage));
        if l.dual_clip > 0.0 {
            let limited = surrogate.maximum(&(&advantage * l.dual_clip));
            surrogate = limited.where_self(&advantage.lt(0.0), &surrogate);
        }
        let entropy = ((log_std + HALF_LN_TAU + 0.5) * own).sum(None);
        -surrogate.mean_dim(&[1i64][..], false, None).sum(None) * l.multiplier
            - entropy * l.entropy_coefficient
    }

    #[test]
    fn actor_gradient_is_that_of_the_definition() {
        let own = Tensor::from_slice(&[1.0f64, 1.0, 1.0, 1.0, 1.0, 0.0]).view([2, 3]);
        for (squash_mean, dual_clip, own) in
            [(true, 0.0, None), (false, 1.3, None), (true, 0.0, Some(&own))]
        {
            let loss = options(squash_mean, dual_clip);
            let (a, u, b) = (2, 3, 50);
            let output = random(1, &[a, u, b]).set_requires_grad(true);
            // One deviation lies below its floor.
            let parameter = Tensor::from_slice(&[0.1, -0.2, -0.9, 0.3, 0.0, -0.3])
                .view([a, u])
                .set_requires_grad(true);
            let [action, old_log_prob, advantage] =
                [random(2, &[a, u, b]), random(3, &[a, 1, b]) * 0.3 - 4.0, random(4, &[a, 1, b])];
            let samples = ActorSamples(Tensor::cat(&[action, old_log_prob, advantage], 1));
            let total = actor_loss(&loss, &output, &parameter, own, &samples);
            total.backward();
            let ours = tch::no_grad(|| loss.gradient(&output, &parameter, own, &samples, b));
            let close = |x: &Tensor, y: &Tensor| {
                let error = (x - y).abs().max().double_value(&[]);
                // The sums are kept in f32: 2⁻²⁴ of each of 50 terms of order 1.
                assert!(error < 1e-5, "{error}");
            };
            close(&ours.output, &output.grad());
            let log_std = tch::no_grad(|| loss.finish_log_std(&ours.log_std, &parameter, own));
            close(&log_std, &parameter.grad());
            let surrogate = ours.sums.select(1, 0).sum(None) / b as f64;
            let entropy = tch::no_grad(|| loss.entropy(&parameter, own)).sum(None);
            close(&(surrogate - entropy * loss.entropy_coefficient), &total.detach());
            assert!(
                ours.sums.select(1, 2).min().double_value(&[]) > 0.0,
                "some ratios are clipped"
            );
        }
    }

    #[test]
    fn critic_gradient_is_that_of_the_definition() {
        for (clip, huber_delta) in [(0.2, 0.7), (0.2, 0.0), (0.0, 0.7), (0.0, 0.0)] {
            let loss = CriticLoss { clip, huber_delta, coefficient: 0.5 };
            let (a, b) = (2, 200);
            let value = random(1, &[a, b]).set_requires_grad(true);
            let old = value.detach() + random(2, &[a, b]) * 0.3;
            let target = random(3, &[a, b]);
            let penalty = |e: Tensor| {
                if huber_delta == 0.0 {
                    e.square() / 2.0
                } else {
                    e.huber_loss(&e.zeros_like(), tch::Reduction::None, huber_delta)
                }
            };
            let plain = penalty(&value - &target);
            let definition = if clip == 0.0 {
                plain
            } else {
                plain.maximum(&penalty(&old + (&value - &old).clamp(-clip, clip) - &target))
            };
            let total = definition.mean_dim(&[1i64][..], false, None).sum(None) * 0.5;
            total.backward();
            let samples = CriticSamples(Tensor::stack(&[&old, &target], 1));
            let (gradient, sums) = tch::no_grad(|| loss.gradient(&value, &samples, b));
            let error = (gradient - value.grad()).abs().max().double_value(&[]);
            assert!(error < 1e-12, "clip {clip}, δ {huber_delta}: {error}");
            let difference = (sums.sum(None) / b as f64 - total).abs().double_value(&[]);
            assert!(difference < 1e-5, "{difference}");
        }
    }

    fn f32s(x: &Tensor) -> Vec<f32> {
        Vec::try_from(x.contiguous().view([-1])).expect("f32")
    }

    /// Which NaN it is means nothing.
    fn bits(numbers: &[f32]) -> Vec<u32> {
        let bits = |x: &f32| if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() };
        numbers.iter().map(bits).collect()
    }

    /// Random samples, and some that are at the edges: no advantage, ratios that overflow, NaN.
    #[test]
    fn passes_over_actors_samples_give_the_bits_of_the_operations() {
        let draw = |seed, shape: &[i64]| random(seed, shape).to_kind(Kind::Float);
        let mut room = ActorRoom::default();
        for (u, b, squash_mean, dual_clip, with_own) in [
            (3, 200, true, 0.0, false),
            (3, 200, false, 1.3, false),
            (6, 501, true, 0.0, true),
            (16, 7, true, 0.0, false),
            (48, 33, true, 1.3, true),
            (1, 1, false, 0.0, false),
        ] {
            let loss = options(squash_mean, dual_clip);
            let parameter = draw(5, &[2, u]) * 0.5;
            let own = with_own.then(|| draw(7, &[2, u]).gt(-0.5).to_kind(Kind::Float));
            // Densities of about the actions' own: ratios on both sides of the limits.
            let old = draw(3, &[2, 1, b]) * 0.3 - 1.4 * u as f64;
            let samples = Tensor::cat(&[draw(2, &[2, u, b]), old, draw(4, &[2, 1, b])], 1);
            // Of the second agent alone: what is no number leaves no sum.
            for (row, column, value) in [(u + 1, 1, 0.0), (u, 2, -200.0), (0, 5, f64::NAN)] {
                if column < b {
                    let _ = samples.get(1).get(row).get(column).fill_(value);
                }
            }
            let output = draw(1, &[2, u, b]);
            let (gradient, sums) = loss.gradient_in_passes(
                &mut room,
                &output,
                &f32s(&parameter),
                own.as_ref().map(f32s).as_deref(),
                &f32s(&samples),
                300,
            );
            let samples = ActorSamples(samples);
            let theirs = loss.gradient(&output, &parameter, own.as_ref(), &samples, 300);
            assert!(bits(&f32s(gradient)) == bits(&f32s(&theirs.output)), "{u} actions");
            let theirs = Tensor::cat(&[theirs.sums, theirs.log_std], 1);
            assert!(bits(sums) == bits(&f32s(&theirs)), "sums, {u} actions");
            assert!(sums[..sums.len() / 2].iter().all(|sum| sum.is_finite()), "{sums:?}");
        }
    }

    #[test]
    fn a_pass_over_critics_samples_gives_the_bits_of_the_operations() {
        let draw = |seed, shape: &[i64]| random(seed, shape).to_kind(Kind::Float);
        let mut room = CriticRoom::default();
        for (clip, huber_delta) in [(0.2, 0.7), (0.2, 0.0), (0.0, 0.7), (0.0, 0.0)] {
            for (critics, each, b) in [(2, 1, 200), (1, 4, 33), (2, 3, 1)] {
                let loss = CriticLoss { clip, huber_delta, coefficient: 0.5 };
                let output = draw(1, &[critics, each, b]);
                let value = output.transpose(0, 1).reshape([-1, b]);
                let samples = value.unsqueeze(1) + draw(2, &[critics * each, 2, b]) * 0.3;
                for (column, value) in [(1, 1e30), (5, f64::NAN)] {
                    if column < b {
                        let _ = samples.get(1).get(1).get(column).fill_(value);
                    }
                }
                let (gradient, sums) =
                    loss.gradient_in_a_pass(&mut room, &output, &f32s(&samples), 300);
                let theirs = loss.gradient(&value, &CriticSamples(samples), 300);
                let by_output = theirs.0.view([each, critics, b]).transpose(0, 1) / each as f64;
                assert!(bits(&f32s(gradient)) == bits(&f32s(&by_output)), "clip {clip}");
                assert!(bits(sums) == bits(&f32s(&theirs.1)), "clip {clip}, δ {huber_delta}");
                assert!(sums[0].is_finite(), "{sums:?}");
            }
        }
    }

    /// U = 1, μ = 0, σ = 1, a = 1, ln p = −½ − 0.91894; old density lower by ln 1.5: ratio 1.5.
    /// A = 2: plain 3, limited 1.2 · 2 = 2.4, so clipped: loss −2.4, no gradient.
    /// A = −2: plain −3 < limited −2.4: loss 3, dL/dμ = −(−2)·1.5·1 = 3; but with a dual clip of 1.25, loss 2.5, no
    /// gradient.
    #[test]
    fn surrogate_worked_by_hand() {
        let loss = |dual_clip| ActorLoss {
            clip: 0.2,
            dual_clip,
            multiplier: 1.0,
            entropy_coefficient: 0.0,
            squash_mean: false,
            min_log_std: -5.0,
        };
        let zeros = Tensor::zeros([1, 1, 1], (Kind::Double, Device::Cpu));
        for (dual_clip, advantage, expected_loss, expected_gradient) in [
            (0.0, 2.0, -2.4, 0.0),
            (0.0, -2.0, 3.0, 3.0),
            (1.25, 2.0, -2.4, 0.0),
            (1.25, -2.0, 2.5, 0.0),
            (1.6, -2.0, 3.0, 3.0),
        ] {
            let loss = loss(dual_clip);
            let columns = [1.0, -0.5 - HALF_LN_TAU - 1.5f64.ln(), advantage];
            let samples = ActorSamples(Tensor::from_slice(&columns).view([1, 3, 1]));
            let g = loss.gradient(&zeros, &zeros.view([1, 1]), None, &samples, 1);
            assert!((g.sums.double_value(&[0, 0]) - expected_loss).abs() < 1e-6);
            assert!((g.output.double_value(&[0, 0, 0]) - expected_gradient).abs() < 1e-6);
            assert!((g.sums.double_value(&[0, 1]) - (0.5 - 1.5f64.ln())).abs() < 1e-6);
            assert_eq!(g.sums.double_value(&[0, 2]), 1.0);
        }
    }
}
