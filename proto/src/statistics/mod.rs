//! Summaries of measured numbers: means, percentiles and intervals.

mod bootstrap;
mod summary;

pub use bootstrap::Resamples;

pub use self::summary::{mean, median, percentile, quantile};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_values_that_were_measured() {
        // Nearest rank on 1…200: 0.99 · 200 = 198 values may lie at or below.
        let values: Vec<f64> = (1..=200).map(f64::from).collect();
        assert_eq!(percentile(&values, 0.99), 198.0);
        assert_eq!(percentile(&values, 0.5), 100.0);
        assert_eq!(percentile(&values, 1.0), 200.0);
        assert_eq!(percentile(&values, 0.0), 1.0);
        assert_eq!(percentile(&[7.0], 0.99), 7.0);
        assert_eq!(percentile(&[], 0.5), 0.0);
    }

    #[test]
    fn quantiles_lie_between_neighbours() {
        let values: Vec<f64> = (0..=10).map(f64::from).collect();
        let quantiles = [0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0].map(|share| quantile(&values, share));
        assert_eq!(quantiles, [0.0, 1.0, 2.5, 5.0, 7.5, 9.0, 10.0]);
        // 0.9 · 4 = 3.6: between 4 and 5.
        assert!((quantile(&[1.0, 2.0, 3.0, 4.0, 5.0], 0.9) - 4.6).abs() < 1e-12);
        assert_eq!(quantile(&[7.0], 0.99), 7.0);
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn medians_and_means_by_hand() {
        assert_eq!(median(vec![3.0, 1.0, f64::INFINITY]), 3.0);
        assert_eq!(median(vec![3.0, 1.0]), 2.0);
        assert_eq!(median(vec![f64::INFINITY, 1.0]), f64::INFINITY);
        assert_eq!(mean(&[1.0, 2.0, 6.0]), 3.0);
        assert!(median(Vec::new()).is_nan() && mean(&[]).is_nan());
    }
}
