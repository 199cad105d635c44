//! The value normaliser: critics predict in units of the returns' running moments.
//!
//! Yu, Velu, Vinitsky, Gao, Wang, Bayen and Wu, "The surprising effectiveness of PPO in cooperative
//! multi-agent games", NeurIPS 2022, section 5.1; the released code calls it `ValueNorm`.
//! Exponential averages of mean and mean square with decay β, both divided by the same average of
//! ones, which removes the bias of starting at zero. The variance is floored at 0.01, so before the
//! first update σ = 0.1.

use tch::{Device, Kind, Tensor};

use crate::actors::Actors;

/// Floor of the variance.
const MIN_VARIANCE: f64 = 1e-2;
/// Floor of the average of ones that divides the moments.
const MIN_DEBIAS: f64 = 1e-5;

/// Running moments of the returns, one pair an agent, in `f64`.
#[derive(Debug)]
pub struct ValueNorm {
    /// `[A]`: average of the returns.
    pub mean: Tensor,
    /// `[A]`: average of their squares.
    pub mean_square: Tensor,
    /// `[A]`: average of ones.
    pub debias: Tensor,
}

impl ValueNorm {
    /// Moments that have seen nothing.
    pub fn new(n_agents: usize, device: Device) -> Self {
        let zeros = || Tensor::zeros([n_agents as i64], (Kind::Double, device));
        Self { mean: zeros(), mean_square: zeros(), debias: zeros() }
    }

    /// The moments of some actors, each a row of `[A]`, in the same memory.
    #[must_use]
    pub(crate) fn part(&self, actors: &Actors) -> Self {
        Self {
            mean: actors.rows(&self.mean),
            mean_square: actors.rows(&self.mean_square),
            debias: actors.rows(&self.debias),
        }
    }

    /// Moves the moments towards those of `returns` `[A, …]`.
    pub fn update(&mut self, returns: &Tensor, beta: f64) {
        let flat = returns.reshape([returns.size()[0], -1]).to_kind(Kind::Double);
        let mean = flat.mean_dim(&[1i64][..], false, None);
        let mean_square = flat.square().mean_dim(&[1i64][..], false, None);
        let mix = |average: &mut Tensor, new: &Tensor| {
            let _ = average.g_mul_scalar_(beta).g_add_(&(new * (1.0 - beta)));
        };
        mix(&mut self.mean, &mean);
        mix(&mut self.mean_square, &mean_square);
        mix(&mut self.debias, &mean.ones_like());
    }

    /// Mean and standard deviation, `[A]` each.
    pub fn mean_and_std(&self) -> (Tensor, Tensor) {
        let debias = self.debias.clamp_min(MIN_DEBIAS);
        let mean = &self.mean / &debias;
        let variance = (&self.mean_square / &debias - mean.square()).clamp_min(MIN_VARIANCE);
        (mean, variance.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(norm: &ValueNorm) -> (f64, f64) {
        let (mean, std) = norm.mean_and_std();
        (mean.double_value(&[0]), std.double_value(&[0]))
    }

    #[test]
    fn one_update_gives_the_batchs_own_moments_whatever_the_decay() {
        for beta in [0.5, 0.99999] {
            let mut norm = ValueNorm::new(1, Device::Cpu);
            assert_eq!(numbers(&norm), (0.0, 0.1));
            norm.update(&Tensor::from_slice(&[1.0f32, 3.0]).view([1, 2]), beta);
            let (mean, std) = numbers(&norm);
            assert!((mean - 2.0).abs() < 1e-9 && (std - 1.0).abs() < 1e-9, "{mean} {std}");
        }
    }

    /// β = ½: averages ½·2 = 1, then ½·1 + ½·8 = 4.5; of ones ½, then ¾: mean 6.
    /// Squares: ½·5 = 2.5, then 1.25 + ½·65 = 33.75; over ¾: 45; variance 45 − 36 = 9.
    #[test]
    fn two_updates_worked_by_hand() {
        let mut norm = ValueNorm::new(1, Device::Cpu);
        norm.update(&Tensor::from_slice(&[1.0f64, 3.0]).view([1, 2]), 0.5);
        norm.update(&Tensor::from_slice(&[7.0f64, 9.0]).view([1, 2]), 0.5);
        let (mean, std) = numbers(&norm);
        assert!((mean - 6.0).abs() < 1e-12 && (std - 3.0).abs() < 1e-12, "{mean} {std}");
    }
}
