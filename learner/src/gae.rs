//! Generalised advantage estimation.
//!
//! Schulman, Moritz, Levine, Jordan and Abbeel, "High-dimensional continuous control using
//! generalized advantage estimation", ICLR 2016, equations 11, 12 and 16:
//!
//! ```text
//! δ_t = r_t + γ V(s_{t+1}) − V(s_t)
//! A_t = δ_t + γ λ A_{t+1}
//! ```
//!
//! A *terminated* step has no future: V(s_{t+1}) counts as zero. A *truncated* step (a time limit)
//! has one that was not played: V(s_{t+1}) counts, unless `bootstrap_truncated` is off. After
//! either, the next advantage belongs to another episode and is not carried over.

use tch::{Kind, Tensor};

/// γ, λ and the treatment of time limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gae {
    /// Discount γ per step.
    pub gamma: f64,
    /// λ.
    pub lambda: f64,
    /// Whether V(s_{t+1}) counts after a truncated step.
    pub bootstrap_truncated: bool,
}

impl Gae {
    /// The advantages `[A, T, N]`.
    ///
    /// Shapes: `reward` `[A, T, N]`, `value` `[A, T + 1, N]`, `terminated` and `truncated`
    /// `[T, N]` of zeros and ones; all of one kind and on one device.
    pub fn advantages(
        &self,
        reward: &Tensor,
        value: &Tensor,
        terminated: &Tensor,
        truncated: &Tensor,
    ) -> Tensor {
        let (agents, steps, envs) = reward.size3().expect("rewards are [A, T, N]");
        debug_assert_eq!(value.size(), [agents, steps + 1, envs]);
        debug_assert_eq!(terminated.size(), [steps, envs]);
        let alive = terminated.ones_like() - terminated;
        let unbroken = &alive * (truncated.ones_like() - truncated);
        let future = if self.bootstrap_truncated { &alive } else { &unbroken };
        let delta =
            reward + value.narrow(1, 1, steps) * (future * self.gamma) - value.narrow(1, 0, steps);
        let carry = unbroken * (self.gamma * self.lambda);
        let advantage = delta;
        let mut next = Tensor::zeros([agents, envs], (reward.kind(), reward.device()));
        for step in (0..steps).rev() {
            let mut current = advantage.select(1, step);
            let _ = current.g_add_(&(next * carry.select(0, step)));
            next = current;
        }
        advantage
    }
}

/// Standardises `[A, …]` advantages over the samples of each agent: zero mean, unit variance
/// (of the sample, n − 1), 1e-5 added to the deviation as the released code does.
pub fn standardise(advantage: &Tensor) -> Tensor {
    let agents = advantage.size()[0];
    let flat = advantage.reshape([agents, -1]).to_kind(Kind::Double);
    let mean = flat.mean_dim(&[1i64][..], true, None);
    let unbiased = flat.size()[1] > 1;
    let std = flat.std_dim(&[1i64][..], unbiased, true);
    ((flat - mean) / (std + 1e-5)).to_kind(advantage.kind()).reshape(advantage.size())
}

#[cfg(test)]
mod tests {
    use super::*;

    const REWARD: [f64; 3] = [1.0, 2.0, 3.0];
    const VALUE: [f64; 4] = [0.5, 1.0, 1.5, 2.0];

    /// [`Gae::advantages`] of one agent and one environment, written as the loop that the equations are. `value` holds one more entry than the others.
    fn advantages_of_one(
        gae: Gae,
        reward: &[f64],
        value: &[f64],
        terminated: &[bool],
        truncated: &[bool],
    ) -> Vec<f64> {
        let mut advantage = vec![0.0; reward.len()];
        let mut next = 0.0;
        for step in (0..reward.len()).rev() {
            let has_future = !terminated[step] && (gae.bootstrap_truncated || !truncated[step]);
            let future = if has_future { value[step + 1] } else { 0.0 };
            let delta = reward[step] + gae.gamma * future - value[step];
            let carried = if terminated[step] || truncated[step] { 0.0 } else { next };
            advantage[step] = delta + gae.gamma * gae.lambda * carried;
            next = advantage[step];
        }
        advantage
    }

    fn one(gae: Gae, terminated: [bool; 3], truncated: [bool; 3]) -> Vec<f64> {
        let tensor = |x: &[f64], len: i64| Tensor::from_slice(x).view([1, len, 1]);
        let flags =
            |x: [bool; 3]| Tensor::from_slice(&x.map(|b| f64::from(u8::from(b)))).view([3, 1]);
        let vectorised = gae.advantages(
            &tensor(&REWARD, 3),
            &tensor(&VALUE, 4),
            &flags(terminated),
            &flags(truncated),
        );
        let vectorised = Vec::<f64>::try_from(vectorised.view([-1])).expect("a vector");
        let loop_twin = advantages_of_one(gae, &REWARD, &VALUE, &terminated, &truncated);
        for (a, b) in vectorised.iter().zip(&loop_twin) {
            assert!((a - b).abs() < 1e-15, "{vectorised:?} {loop_twin:?}");
        }
        loop_twin
    }

    fn assert_near(left: &[f64], right: [f64; 3]) {
        for (a, b) in left.iter().zip(right) {
            assert!((a - b).abs() < 1e-12, "{left:?} {right:?}");
        }
    }

    /// γ = ½, λ = ½. δ = 1 + ½·1 − ½ = 1; 2 + ½·1.5 − 1 = 1.75; 3 + ½·2 − 1.5 = 2.5.
    /// A₂ = 2.5; A₁ = 1.75 + ¼·2.5 = 2.375; A₀ = 1 + ¼·2.375 = 1.59375.
    #[test]
    fn worked_by_hand() {
        let gae = Gae { gamma: 0.5, lambda: 0.5, bootstrap_truncated: true };
        let open = one(gae, [false; 3], [false; 3]);
        assert_near(&open, [1.59375, 2.375, 2.5]);
        // A time limit after the last step leaves its value in.
        assert_eq!(open, one(gae, [false; 3], [false, false, true]));
        // A true end takes it out: δ₂ = 3 − 1.5 = 1.5; A₁ = 1.75 + 0.375; A₀ = 1 + 0.53125.
        assert_near(&one(gae, [false, false, true], [false; 3]), [1.53125, 2.125, 1.5]);
        // So does a time limit that is treated as an end.
        let faithful = Gae { bootstrap_truncated: false, ..gae };
        assert_near(&one(faithful, [false; 3], [false, false, true]), [1.53125, 2.125, 1.5]);
        // An end in the middle: δ₁ = 2 − 1 = 1 and nothing is carried over it; A₀ = 1 + ¼.
        assert_near(&one(gae, [false, true, false], [false; 3]), [1.25, 1.0, 2.5]);
        // A time limit in the middle keeps δ₁ = 1.75 but carries nothing: A₀ = 1 + ¼·1.75.
        assert_near(&one(gae, [false; 3], [false, true, false]), [1.4375, 1.75, 2.5]);
    }

    #[test]
    fn standardised_advantages_have_zero_mean_and_unit_deviation_per_agent() {
        let raw =
            Tensor::from_slice(&[1.0f64, 2.0, 3.0, 4.0, 10.0, 10.0, 30.0, 30.0]).view([2, 2, 2]);
        let flat = standardise(&raw).view([2, 4]);
        for agent in 0..2 {
            let row = flat.get(agent);
            assert!(row.mean(None).double_value(&[]).abs() < 1e-12);
            assert!((row.std(true).double_value(&[]) - 1.0).abs() < 1e-5);
        }
    }
}
