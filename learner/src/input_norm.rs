//! Normalisation of network inputs: none, each input by itself, or by running moments.
//!
//! Running moments are mean and variance of every feature over all samples of the run, by the parallel update
//! of Chan, Golub and LeVeque, "Algorithms for computing the sample variance", The American Statistician
//! 1983, equation 2.1. An input becomes clip((x − mean) · inverse_std, ± `input_clip`).
//!
//! Actions are sampled with the normaliser that was published with their policy. So the normaliser
//! changes after an iteration's update, together with the policy, never between rollout and
//! update (but with `run.overlap`, where a policy acts while its successor is learned). The first iteration alone is trained with its own moments: an untrained policy has
//! nothing to unlearn, and critics would otherwise begin on raw inputs.

use proto::config::{InputNorm as InputNormKind, Network};
use tch::Tensor;

use crate::features::{Features, Loop, run_for};
use crate::layer_norm::standardise_input;
use crate::limits::clamp;
use crate::number::Number;

/// Added to the variance, so that a feature that never moves does not divide by zero.
const EPSILON: f64 = 1e-6;

/// How a configuration normalises inputs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Normalisation {
    kind: InputNormKind,
    clip: f64,
}

impl Normalisation {
    /// Of `network`'s actors and critics.
    pub(crate) fn new(network: &Network) -> Self {
        Self { kind: network.input_norm, clip: network.input_clip }
    }

    /// Whether an input is a matter of its own number alone, or of all inputs of a sample.
    pub(crate) fn is_of_each_number(self) -> bool {
        self.kind != InputNormKind::LayerNorm
    }

    /// The inputs `x` as networks see them, rounded, where [`Self::is_of_each_number`]; with the bits of [`Self::normalise`]. `moments` are mean and inverse
    /// deviation in force, one an input.
    ///
    /// # Panics
    /// As [`Self::normalise`], or if this is not for each number.
    #[inline(always)]
    pub(crate) fn normalise_each<T: Number>(
        self,
        x: &[f32],
        moments: Option<[&[f32]; 2]>,
        out: &mut [T],
    ) {
        match self.kind {
            InputNormKind::None => {
                out.iter_mut().zip(x).for_each(|(out, &x)| *out = T::round(x));
            }
            InputNormKind::LayerNorm => unreachable!("all inputs of a sample together"),
            InputNormKind::Running => {
                let [mean, inverse_std] = moments.expect("running moments");
                let clip = self.clip as f32;
                for (((out, x), mean), inverse_std) in
                    out.iter_mut().zip(x).zip(mean).zip(inverse_std)
                {
                    *out = T::round(clamp((x - mean) * inverse_std, [-clip, clip]));
                }
            }
        }
    }

    /// `x` `[…, features]` as networks see it. `moments` are mean and inverse deviation in force, in a
    /// shape that broadcasts over `x`.
    ///
    /// # Panics
    /// If running moments are asked for and there are none.
    pub(crate) fn normalise(self, x: &Tensor, moments: Option<&(Tensor, Tensor)>) -> Tensor {
        match self.kind {
            InputNormKind::None => x.shallow_clone(),
            InputNormKind::LayerNorm => standardise_input(x),
            InputNormKind::Running => {
                let (mean, inverse_std) = moments.expect("running moments");
                let mut x = (x - mean).g_mul_(inverse_std);
                x.clamp_(-self.clip, self.clip)
            }
        }
    }
}

/// Running moments of `rows` × `features` inputs, in `f64`.
#[derive(Debug, Clone, PartialEq)]
pub struct InputNorm {
    /// Number of independent rows (agents, or 1).
    pub rows: usize,
    /// Features of a row.
    pub features: usize,
    /// Samples seen by each row.
    pub count: f64,
    /// `[rows, features]`: mean.
    pub mean: Vec<f64>,
    /// `[rows, features]`: sum of squared deviations from the mean.
    pub m2: Vec<f64>,
}

impl InputNorm {
    /// Moments that have seen nothing: they normalise to the input itself.
    pub fn new(rows: usize, features: usize) -> Self {
        let zeros = vec![0.0; rows * features];
        Self { rows, features, count: 0.0, mean: zeros.clone(), m2: zeros }
    }

    /// Adds samples. `batch` holds, for each row, blocks of contiguous samples `[…, features]`, in
    /// an order that must not depend on when they arrived.
    ///
    /// # Panics
    /// If the rows' numbers of samples differ.
    pub fn update(&mut self, batch: &[Vec<&[f32]>]) {
        assert_eq!(batch.len(), self.rows, "one list of blocks a row");
        let samples =
            |blocks: &Vec<&[f32]>| blocks.iter().map(|b| b.len()).sum::<usize>() / self.features;
        let n = samples(&batch[0]);
        if n == 0 {
            return;
        }
        let total = self.count + n as f64;
        let mut sum = vec![0.0; self.features];
        let mut square = vec![0.0; self.features];
        for (row, blocks) in batch.iter().enumerate() {
            assert_eq!(samples(blocks), n, "row {row} has another number of samples");
            // Deviations from the first sample keep the sums small, so nothing cancels.
            let pivot = &blocks[0][..self.features];
            sum.fill(0.0);
            square.fill(0.0);
            for block in blocks {
                let sums = [&mut sum[..], &mut square[..]];
                run_for(Features::detect(), Deviations { block, pivot, sums });
            }
            let range = row * self.features..(row + 1) * self.features;
            let running = self.mean[range.clone()].iter_mut().zip(&mut self.m2[range]);
            for (feature, (mean, m2)) in running.enumerate() {
                let shift = sum[feature] / n as f64;
                let batch_m2 = (square[feature] - shift * sum[feature]).max(0.0);
                let delta = f64::from(pivot[feature]) + shift - *mean;
                *m2 += batch_m2 + delta * delta * self.count * n as f64 / total;
                *mean += delta * n as f64 / total;
            }
        }
        self.count = total;
    }

    /// Gives every `networks`-th row the moments of their union, for the network that they share.
    pub fn pool(&mut self, networks: usize) {
        let rows = (self.rows / networks) as f64;
        for (network, feature) in
            (0..networks).flat_map(|n| (0..self.features).map(move |f| (n, f)))
        {
            let of_network = (network..self.rows).step_by(networks);
            let indices = of_network.map(|row| row * self.features + feature);
            let mean = indices.clone().map(|index| self.mean[index]).sum::<f64>() / rows;
            let spread = indices
                .clone()
                .map(|index| self.m2[index] + self.count * (self.mean[index] - mean).powi(2))
                .sum::<f64>();
            for index in indices {
                self.mean[index] = mean;
                self.m2[index] = spread / rows;
            }
        }
    }

    /// Mean and inverse standard deviation as networks use them, `[rows, features]` each.
    pub fn mean_and_inverse_std(&self) -> (Vec<f32>, Vec<f32>) {
        if self.count == 0.0 {
            return (vec![0.0; self.mean.len()], vec![1.0; self.mean.len()]);
        }
        let mean = self.mean.iter().map(|&x| x as f32).collect();
        let inverse =
            self.m2.iter().map(|&x| (1.0 / (x / self.count + EPSILON).sqrt()) as f32).collect();
        (mean, inverse)
    }
}

/// Adds the deviations of the samples of `block` from `pivot`, and their squares, to `sums`, each feature in the order of the samples.
struct Deviations<'a> {
    block: &'a [f32],
    pivot: &'a [f32],
    sums: [&'a mut [f64]; 2],
}

impl Loop for Deviations<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { block, pivot, sums: [sum, square] } = self;
        for sample in block.chunks_exact(pivot.len()) {
            for (((x, p), s), q) in sample.iter().zip(pivot).zip(&mut *sum).zip(&mut *square) {
                let deviation = f64::from(*x) - f64::from(*p);
                *s += deviation;
                // Not fused: the bits of a state are those of every processor.
                *q += deviation * deviation;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_batches_give_the_moments_of_all_samples() {
        let mut norm = InputNorm::new(1, 2);
        norm.update(&[vec![&[1.0, 10.0, 3.0, 10.0]]]);
        norm.update(&[vec![&[5.0, 10.0], &[7.0, 10.0]]]);
        assert_eq!(norm.mean, [4.0, 10.0]);
        assert!((norm.m2[0] - 20.0).abs() < 1e-12 && norm.m2[1] == 0.0, "{:?}", norm.m2);
        let (mean, inverse) = norm.mean_and_inverse_std();
        assert_eq!(mean, [4.0, 10.0]);
        assert!((inverse[0] - (5.0f32 + 1e-6).sqrt().recip()).abs() < 1e-7);
        assert!((inverse[1] - 1000.0).abs() < 1e-3);
    }

    #[test]
    fn pooled_rows_have_the_moments_of_their_union() {
        let mut norm = InputNorm::new(2, 1);
        norm.update(&[vec![&[1.0, 3.0]], vec![&[5.0, 7.0]]]);
        norm.pool(1);
        assert_eq!(norm.mean, [4.0, 4.0]);
        // Union: deviations −3, −1, 1, 3; variance 5 over two samples a row.
        assert_eq!(norm.m2, [10.0, 10.0]);
    }
}
