//! How sure a mean over few runs is: the percentile bootstrap (Efron, "Bootstrap methods: another look at the
//! jackknife", 1979), which Agarwal et al., "Deep reinforcement learning at the edge of the statistical
//! precipice", 2021, recommend for runs that differ in their seeds.

use super::summary::mean;
use crate::rng::{Address, Purpose};

/// Share of the resamples on either side of the interval.
const OUTSIDE: f64 = 0.025;
/// Resamples, where there are too many to take all.
const DRAWN: usize = 2_000;

/// Samples of `n` runs, each drawn `n` times with replacement: all of them up to four runs, else 2,000, always the same.
#[derive(Debug, Clone)]
pub struct Resamples(Vec<Vec<usize>>);

impl Resamples {
    /// Samples of `n` runs.
    pub fn of(n: usize) -> Self {
        if n <= 4 {
            // A resample is a number of `n` digits to the base `n`.
            let digits = |code: usize| (0..n as u32).map(move |k| code / n.pow(k) % n);
            return Self((0..n.pow(n as u32)).map(|code| digits(code).collect()).collect());
        }
        let draw = |sample: usize| {
            let word = |index: usize| {
                let (step, index_of_four) = ((index / 4) as u32, index % 4);
                let address = Address {
                    seed: 0,
                    purpose: Purpose::Bootstrap,
                    iteration: sample as u32,
                    env: 0,
                    step,
                    index: 0,
                };
                address.words()[index_of_four]
            };
            (0..n).map(|index| ((u64::from(word(index)) * n as u64) >> 32) as usize).collect()
        };
        Self((0..DRAWN).map(draw).collect())
    }

    /// `[low, mean, high]`: the mean of `values`, one a run, within its 95 % interval; `values` are as many as the runs.
    /// Of three runs that is all that they span: each is drawn three times by one resample in 27, more than are left out on either side.
    pub fn interval(&self, values: &[f64]) -> [f64; 3] {
        let n = values.len() as f64;
        let mut means: Vec<f64> = self
            .0
            .iter()
            .map(|sample| sample.iter().map(|run| values[*run]).sum::<f64>() / n)
            .collect();
        means.sort_by(f64::total_cmp);
        let outside = (OUTSIDE * means.len() as f64) as usize;
        [means[outside], mean(values), means[means.len() - 1 - outside]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_by_hand() {
        let interval = |values: &[f64]| Resamples::of(values.len()).interval(values);
        assert_eq!(interval(&[2.0]), [2.0, 2.0, 2.0]);
        assert_eq!(interval(&[2.0, 4.0]), [2.0, 3.0, 4.0]);
        assert_eq!(interval(&[0.0, 3.0, 9.0]), [0.0, 4.0, 9.0]);
        // Of 256 resamples six are outside on either side. From below they are one of 0, 0, 0, 0, four of 0, 0, 0, 1 in some
        // order and one of six of 0, 0, 1, 1; from above one of 64s alone, four with an 8 and one of four with a 1.
        assert_eq!(interval(&[0.0, 1.0, 8.0, 64.0]), [0.5, 18.25, 48.25]);
    }

    #[test]
    fn many_runs_have_the_interval_of_a_normal_mean() {
        let n = 60;
        let at = |k: usize| {
            let address = Address {
                seed: 1,
                purpose: Purpose::Bootstrap,
                iteration: 0,
                env: 1,
                step: k as u32,
                index: 0,
            };
            f64::from(address.normals()[0])
        };
        let values: Vec<f64> = (0..n).map(at).collect();
        let [low, mean, high] = Resamples::of(n).interval(&values);
        let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n as f64;
        let reach = 1.96 * (variance / n as f64).sqrt();
        for (end, expected) in [(low, mean - reach), (high, mean + reach)] {
            assert!((end - expected).abs() < 0.1 * reach, "{end} and {expected}");
        }
    }
}
