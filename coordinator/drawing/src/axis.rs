//! Axes: how values become places, where the lines of the grid are, and what their labels say.

use std::ops::Range;

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint};
use plotters::prelude::Ranged;

/// Share of what is shown that is left free on either side.
const MARGIN: f64 = 0.05;
/// Most powers that are labelled, for which there is room side by side.
const MOST_LABELS: usize = 9;

/// An axis.
#[derive(Debug, Clone)]
pub struct Axis {
    /// What it shows, with its unit.
    pub name: String,
    /// How it is divided.
    pub scale: Scale,
    /// The value at its beginning.
    pub low: f64,
    /// The value at its end.
    pub high: f64,
}

/// How an axis is divided.
#[derive(Debug, Clone, PartialEq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By the logarithm, with labels at 1, 2 and 5 of every decade, or at decades if there are many.
    Log,
    /// By the logarithm, with labels at powers of two.
    PowersOfTwo,
    /// A name at 0, 1, 2, …
    Names(Vec<String>),
}

impl Axis {
    /// From `low` to `high`, evenly.
    pub fn linear(name: &str, low: f64, high: f64) -> Self {
        let high = if high > low { high } else { low + 1.0 };
        Self { name: name.to_owned(), scale: Scale::Linear, low, high }
    }

    /// Even, with room around all of `values`.
    pub fn around(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let (low, high) = span(values).unwrap_or((0.0, 1.0));
        let margin = if high > low { MARGIN * (high - low) } else { 0.5 };
        Self::linear(name, low - margin, high + margin)
    }

    /// Even, from 0 to a little above the largest of `values`.
    pub fn from_zero(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let high = span(values).map_or(0.0, |(_, high)| high);
        Self::linear(name, 0.0, (1.0 + MARGIN) * high)
    }

    /// Names side by side.
    pub fn names(name: &str, names: Vec<String>) -> Self {
        let high = names.len() as f64 - 0.5;
        Self { name: name.to_owned(), scale: Scale::Names(names), low: -0.5, high }
    }

    /// Logarithmic, with room for all of `values` that are above zero, and at least for a factor of ten.
    pub fn log(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        // Beyond these neither products nor decades are numbers any more.
        let positive = values.into_iter().filter(|value| (1e-300..1e300).contains(value));
        let (low, high) = span(positive).map_or((0.1, 1.0), |(low, high)| (0.8 * low, 1.25 * high));
        let middle = low.sqrt() * high.sqrt();
        let reach = (high / middle).max(10_f64.sqrt());
        Self { name: name.to_owned(), scale: Scale::Log, low: middle / reach, high: middle * reach }
    }

    /// Logarithmic, between the powers of two around all of `values` that are above zero.
    pub fn powers_of_two(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let powers = values.into_iter().filter(|value| *value > 0.0).map(f64::log2);
        let (first, last) = span(powers).unwrap_or((0.0, 1.0));
        let (first, last) = (first.floor(), last.ceil().max(first.floor() + 1.0));
        // Less than to the next power, which would be labelled.
        let margin = (MARGIN * (last - first)).min(0.5);
        let [low, high] = [first - margin, last + margin].map(f64::exp2);
        Self { name: name.to_owned(), scale: Scale::PowersOfTwo, low, high }
    }

    /// The nearest value that is on the axis.
    pub(crate) fn clamp(&self, value: f64) -> f64 {
        value.clamp(self.low, self.high)
    }

    /// Whether a value has a place on the axis or beyond its ends.
    pub(crate) fn shows(&self, value: f64) -> bool {
        let logarithmic = matches!(self.scale, Scale::Log | Scale::PowersOfTwo);
        value.is_finite() && (value > 0.0 || !logarithmic)
    }

    /// Values that have a line and a label.
    pub(crate) fn ticks(&self) -> Vec<f64> {
        let within = |value: &f64| (self.low..=self.high).contains(value);
        match &self.scale {
            Scale::Names(names) => (0..names.len()).map(|index| index as f64).collect(),
            Scale::Linear => {
                let rough = (self.high - self.low) / 6.0;
                let decade = 10_f64.powf(rough.log10().floor());
                let steps = [1.0, 2.0, 2.5, 5.0, 10.0].map(|digit| digit * decade);
                let step = steps.into_iter().find(|step| *step >= rough).unwrap_or(rough);
                let first = (self.low / step).ceil() as i64;
                let last = (self.high / step + 1e-9).floor() as i64;
                (first..=last).map(|index| index as f64 * step).collect()
            }
            Scale::Log => {
                let digits: &[f64] =
                    if self.high / self.low > 300.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
                let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
                let stride = decades.clone().count().div_ceil(MOST_LABELS);
                decades
                    .step_by(stride)
                    .flat_map(|decade| digits.iter().map(move |digit| digit * 10_f64.powi(decade)))
                    .filter(within)
                    .collect()
            }
            Scale::PowersOfTwo => {
                let powers = self.low.log2().ceil() as i32..=self.high.log2().floor() as i32;
                let stride = powers.clone().count().div_ceil(MOST_LABELS).max(1);
                powers.step_by(stride).map(|power| 2_f64.powi(power)).collect()
            }
        }
    }

    /// What stands at a value.
    pub(crate) fn label(&self, value: f64) -> String {
        match &self.scale {
            Scale::Names(names) => names.get(value.round() as usize).cloned().unwrap_or_default(),
            // One unit for all labels: 0.5 M stands beside 1 M.
            Scale::Linear => number(value, self.low.abs().max(self.high.abs())),
            Scale::Log => number(value, value.abs()),
            Scale::PowersOfTwo => power_of_two(value),
        }
    }
}

/// The smallest and the largest of those that are finite.
fn span(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let finite = values.into_iter().filter(|value| value.is_finite());
    finite.fold(None, |span, value| {
        let (low, high) = span.unwrap_or((value, value));
        Some((low.min(value), high.max(value)))
    })
}

impl Ranged for Axis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = match self.scale {
            Scale::Log | Scale::PowersOfTwo => {
                (value / self.low).ln() / (self.high / self.low).ln()
            }
            Scale::Linear | Scale::Names(_) => (value - self.low) / (self.high - self.low),
        };
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks() }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

/// A number without a tail of zeros, in the unit that suits `size`: `250 k`, `0.05`, `20`.
fn number(value: f64, size: f64) -> String {
    let (unit, suffix) = match size {
        size if size >= 1e9 => (1e9, " G"),
        size if size >= 1e6 => (1e6, " M"),
        size if size >= 1e4 => (1e3, " k"),
        _ => (1.0, ""),
    };
    let value = value / unit;
    let size = value.abs();
    if size == 0.0 {
        return "0".to_owned();
    }
    if size < 1e-4 {
        return format!("{value:.1e}").replace(".0e", "e");
    }
    // Four digits, and as many as steps of a quarter need.
    let decimals = (3 - size.log10().floor() as i32).max(2) as usize;
    let text = format!("{value:.decimals$}");
    format!("{}{suffix}", text.trim_end_matches('0').trim_end_matches('.'))
}

/// A power of two by its digits, from 2^20 on in binary units: `0.5`, `16,384`, `64 Mi`.
fn power_of_two(value: f64) -> String {
    let (mebi, gibi) = (2_f64.powi(20), 2_f64.powi(30));
    match value {
        value if value >= gibi => format!("{} Gi", value / gibi),
        value if value >= mebi => format!("{} Mi", value / mebi),
        value if value >= 1e3 => format!("{},{:03}", value as u64 / 1000, value as u64 % 1000),
        value => number(value, value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: &Axis) -> Vec<String> {
        axis.ticks().into_iter().map(|value| axis.label(value)).collect()
    }

    #[test]
    fn axes_have_round_labels_and_room() {
        assert_eq!(Axis::linear("", 0.0, 200.0).ticks(), [0.0, 50.0, 100.0, 150.0, 200.0]);
        let log = Axis::log("", [4.0, 0.0, f64::NAN, 30.0]);
        assert!(log.low < 4.0 && log.high > 30.0);
        assert_eq!(log.ticks(), [5.0, 10.0, 20.0]);
        // Of thirteen decades every second.
        assert_eq!(Axis::log("", [1.1e-6, 1e6]).ticks().len(), 6);
        let extreme = Axis::log("", [f64::MIN_POSITIVE, 1e-290, 1e290, f64::MAX]);
        assert!(extreme.low > 0.0 && extreme.high.is_finite() && extreme.ticks().len() < 10);
        // One value alone has a decade of room.
        let one = Axis::log("", [1.0]);
        assert!((one.high / one.low - 10.0).abs() < 1e-9);
        let names = Axis::names("", vec!["a".to_owned(), "b".to_owned()]);
        assert_eq!((names.low, names.high, names.label(1.0)), (-0.5, 1.5, "b".to_owned()));
        let around = Axis::around("", [-10.0, f64::INFINITY, 10.0]);
        assert_eq!((around.low, around.high), (-11.0, 11.0));
        assert_eq!(Axis::from_zero("", [5.0, 8.0]).ticks(), [0.0, 2.0, 4.0, 6.0, 8.0]);
    }

    #[test]
    fn axes_of_nothing_have_labels_too() {
        let empty = std::iter::empty::<f64>;
        for axis in [
            Axis::around("", empty()),
            Axis::around("", [3.0, 3.0]),
            Axis::from_zero("", empty()),
            Axis::log("", empty()),
            Axis::powers_of_two("", empty()),
        ] {
            assert!(axis.low < axis.high && axis.ticks().len() > 1, "{axis:?}");
        }
    }

    #[test]
    fn powers_of_two_are_between_those_around_the_values() {
        let axis = Axis::powers_of_two("", [100.0, 0.0, 5000.0]);
        let expected = ["64", "128", "256", "512", "1,024", "2,048", "4,096", "8,192"];
        assert_eq!(labels(&axis), expected);
        assert_eq!(labels(&Axis::powers_of_two("", [0.5])), ["0.5", "1"]);
        // Of 21 powers every third.
        let many = Axis::powers_of_two("", [1.0, 1_048_576.0]);
        assert_eq!(labels(&many), ["1", "8", "64", "512", "4,096", "32,768", "262,144"]);
        let bytes = labels(&Axis::powers_of_two("", [2e6, 8e7]));
        assert_eq!(bytes, ["1 Mi", "2 Mi", "4 Mi", "8 Mi", "16 Mi", "32 Mi", "64 Mi", "128 Mi"]);
    }

    #[test]
    fn labels_of_an_axis_have_one_unit() {
        assert_eq!(labels(&Axis::linear("", 0.0, 1.65e6)), ["0", "0.5 M", "1 M", "1.5 M"]);
        assert_eq!(
            labels(&Axis::linear("", -1.2e4, 3e3)),
            ["-10 k", "-7.5 k", "-5 k", "-2.5 k", "0", "2.5 k"]
        );
        let texts = [250_000.0, 0.05, 20.0, -0.001, 1.5e6, 0.8, 1002.5, 2e-5, 1.0 / 3.0];
        let texts = texts.map(|value: f64| number(value, value.abs()));
        assert_eq!(
            texts,
            ["250 k", "0.05", "20", "-0.001", "1.5 M", "0.8", "1002.5", "2e-5", "0.3333"]
        );
    }
}
