//! What an evaluation and the experiments say of errors: of what, in which unit, and how they spread.

use std::fmt;

use proto::config::TaskName;
use proto::statistics::{mean, quantile};
use run::selection::PAPER;
use serde::{Deserialize, Deserializer, Serialize};

/// Mean, spread and percentiles over a set of errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Arithmetic mean.
    #[serde(deserialize_with = "number")]
    pub mean: f64,
    /// Standard deviation.
    #[serde(deserialize_with = "number")]
    pub std: f64,
    /// Median.
    #[serde(deserialize_with = "number")]
    pub p50: f64,
    /// 90th percentile.
    #[serde(deserialize_with = "number")]
    pub p90: f64,
    /// 99th percentile.
    #[serde(deserialize_with = "number")]
    pub p99: f64,
}

/// A number, or `null`, which stands for one that JSON cannot write.
pub(crate) fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

impl Spread {
    /// Of `values`; percentiles are interpolated between neighbours. Nothing is known of no values at all:
    /// all are NaN.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let mean = mean(&values);
        let variance =
            values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
        let [p50, p90, p99] = [0.5, 0.9, 0.99].map(|share| quantile(&values, share));
        Self { mean, std: variance.sqrt(), p50, p90, p99 }
    }
}

/// What an error is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ErrorOf {
    /// Position of a hand.
    Position,
    /// Orientation of a hand.
    Orientation,
    /// Attitude of the base.
    Base,
}

impl ErrorOf {
    /// What the errors of a task are of, in the order in which they are shown.
    pub fn of(task: TaskName) -> impl Iterator<Item = Self> {
        let hands = [Self::Position, Self::Orientation].into_iter().filter(move |_| task.reaches());
        hands.chain(task.turns().then_some(Self::Base))
    }

    /// What the paper reports for its best policies (m or rad).
    pub fn papers(self) -> f64 {
        thousandths(match self {
            Self::Position => PAPER.position,
            Self::Orientation => PAPER.orientation,
            Self::Base => PAPER.base,
        })
    }

    /// What it is measured in.
    pub fn unit(self) -> Unit {
        match self {
            Self::Position => Unit::Metre,
            Self::Orientation | Self::Base => Unit::Radian,
        }
    }
}

impl fmt::Display for ErrorOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Orientation => "orientation",
            Self::Base => "base",
        })
    }
}

/// What an error is measured in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// m.
    #[serde(rename = "m")]
    Metre,
    /// rad.
    #[serde(rename = "rad")]
    Radian,
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Metre => "m",
            Self::Radian => "rad",
        })
    }
}

/// A single-precision number of thousandths in double precision.
pub fn thousandths(value: f32) -> f64 {
    (1e3 * f64::from(value)).round() / 1e3
}

/// A number in thousandths: mm or mrad. A dash where there was nothing to measure.
pub fn milli(value: f64) -> String {
    if value.is_nan() { "-".to_owned() } else { format!("{:.1}", 1e3 * value) }
}

/// A share as a person reads it; a dash where there was nothing to share.
pub fn percent(share: f64) -> String {
    if share.is_nan() { "-".to_owned() } else { format!("{:.1} %", 100.0 * share) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_by_hand() {
        let spread = Spread::of(vec![4.0, 1.0, 2.0, 3.0, 5.0]);
        assert_eq!((spread.mean, spread.p50), (3.0, 3.0));
        assert_eq!(spread.std, 2.0_f64.sqrt());
        // 0.9 · 4 = 3.6: between 4 and 5.
        assert!((spread.p90 - 4.6).abs() < 1e-12);
        assert_eq!(Spread::of(vec![7.0]).p99, 7.0);
    }

    #[test]
    fn nothing_is_said_of_no_values() {
        let spread = Spread::of(Vec::new());
        let text = serde_json::to_string(&spread).expect("JSON");
        assert_eq!(text, r#"{"mean":null,"std":null,"p50":null,"p90":null,"p99":null}"#);
        let Spread { mean, std, p50, p90, p99 } = serde_json::from_str(&text).expect("read back");
        assert_eq!([mean, std, p50, p90, p99].map(milli), ["-"; 5]);
        assert_eq!((percent(f64::NAN), percent(0.0)), ("-".to_owned(), "0.0 %".to_owned()));
    }

    #[test]
    fn thousandths_of_single_precision_are_the_papers_again() {
        let papers = |task| ErrorOf::of(task).map(ErrorOf::papers).collect::<Vec<f64>>();
        assert_eq!(papers(TaskName::Trajectory), [0.025, 0.04]);
        assert_eq!(papers(TaskName::Reorientation), [0.03]);
        assert_eq!(papers(TaskName::Mixed), [0.025, 0.04, 0.03]);
        assert_eq!(thousandths(0.015), 0.015);
    }
}
