//! The figures of a measurement, as a table and as JSON.

use output::grouped;
use proto::{ExitCode, ExitError};
use serde_json::{Map, Value};

/// Whether more is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sense {
    Rate,
    Cost,
}

/// A number with what it is compared with.
#[derive(Debug, Clone)]
pub(super) struct Figure {
    key: String,
    unit: &'static str,
    value: f64,
    sense: Sense,
    peer: Option<f64>,
    floor: Option<f64>,
    limit: Option<f64>,
}

impl Figure {
    /// More is better.
    pub(super) fn rate(key: impl Into<String>, unit: &'static str, value: f64) -> Self {
        Self {
            key: key.into(),
            unit,
            value,
            sense: Sense::Rate,
            peer: None,
            floor: None,
            limit: None,
        }
    }

    /// Less is better.
    pub(super) fn cost(key: impl Into<String>, unit: &'static str, value: f64) -> Self {
        Self { sense: Sense::Cost, ..Self::rate(key, unit, value) }
    }

    /// What another program reaches with the same work.
    pub(super) fn peer(self, peer: Option<f64>) -> Self {
        Self { peer, ..self }
    }

    /// The best that the machine allows.
    pub(super) fn floor(self, floor: Option<f64>) -> Self {
        Self { floor, ..self }
    }

    /// What no processor of this kind can do.
    pub(super) fn limit(self, limit: Option<f64>) -> Self {
        Self { limit, ..self }
    }

    /// Why its numbers cannot all be right, if they cannot.
    fn doubt(&self) -> Option<String> {
        let Self { key, unit, value, .. } = self;
        let shown = number(*value);
        // What is no number is not possible either.
        let possible = self.floor.is_none_or(|floor| self.advantage(floor) <= 1.0);
        if let Some(floor) = self.floor.filter(|_| !possible) {
            let floor = number(floor);
            return Some(format!(
                "{key}: measured {shown} {unit} is better than its floor of {floor}"
            ));
        }
        let limit = number(self.limit.filter(|limit| value > limit)?);
        Some(format!("{key}: measured {shown} {unit}, the processor's peak is {limit}"))
    }

    /// How many times better than `other`.
    fn advantage(&self, other: f64) -> f64 {
        match self.sense {
            Sense::Rate => self.value / other,
            Sense::Cost => other / self.value,
        }
    }

    fn cells(&self) -> [String; 7] {
        let number = |value: Option<f64>| value.map(number).unwrap_or_default();
        let ratio = self.peer.map(|peer| format!("{:.2}×", self.advantage(peer)));
        let share = self.floor.map(|floor| format!("{:.0} %", 100.0 * self.advantage(floor)));
        [
            self.key.clone(),
            self.unit.to_owned(),
            number(Some(self.value)),
            number(self.peer),
            ratio.unwrap_or_default(),
            number(self.floor),
            share.unwrap_or_default(),
        ]
    }
}

/// All figures, in the order in which they were measured.
#[derive(Debug, Default)]
pub(super) struct Figures(Vec<Figure>);

impl Figures {
    pub(super) fn push(&mut self, figure: Figure) {
        self.0.push(figure);
    }

    /// A value that has been measured already.
    pub(super) fn value(&self, key: &str) -> Option<f64> {
        self.0.iter().find(|figure| figure.key == key).map(|figure| figure.value)
    }

    /// Refuses floors that are none: what was measured is better than the best that was found possible, or that is more than
    /// the processor can do. `load` says what else went on.
    pub(super) fn check(&self, load: &str) -> Result<(), ExitError> {
        let doubts: Vec<String> = self.0.iter().filter_map(Figure::doubt).collect();
        if doubts.is_empty() {
            return Ok(());
        }
        Err(ExitError::new(
            ExitCode::Failure,
            format!(
                "the measurements contradict each other, so that none is shown:\n  {}\n{load}; measure again when \
                 the machine is idle, or longer, by --seconds",
                doubts.join("\n  ")
            ),
        ))
    }

    /// For people.
    pub(super) fn table(&self) -> String {
        let header = ["figure", "unit", "measured", "peer", "ratio", "floor", "share"];
        output::table(header, self.0.iter().map(Figure::cells))
    }

    /// One flat object; what a figure `a.b` is compared with is `a.peer_b` and `a.floor_b`.
    pub(super) fn to_json(&self) -> Value {
        let mut object = Map::new();
        for Figure { key, value, peer, floor, .. } in &self.0 {
            object.insert(key.clone(), (*value).into());
            let (group, name) = key.rsplit_once('.').unwrap_or(("", key));
            for (prefix, compared) in [("peer", peer), ("floor", floor)] {
                if let Some(compared) = compared {
                    object.insert(format!("{group}.{prefix}_{name}"), (*compared).into());
                }
            }
        }
        Value::Object(object)
    }
}

/// Three digits, or all before the point.
pub(super) fn number(value: f64) -> String {
    match value.abs() {
        size if size >= 100.0 => grouped(value.round() as u64),
        size if size >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_cannot_be_right_end_in_an_error() {
        let check = |figure: Figure| Figures(vec![figure]).check("others took 90 %");
        let rate = || Figure::rate("learner.rate", "env-steps/s", 3000.0);
        let cost = || Figure::cost("transport.p50_us", "µs", 30.0);
        let product = || Figure::rate("learner.f32.product_gflop_per_s", "GFLOP/s", 1442.0);
        for possible in [
            rate(),
            rate().floor(Some(3000.0)),
            rate().floor(Some(4000.0)),
            cost().floor(Some(20.0)),
            product().limit(Some(1500.0)),
        ] {
            assert!(check(possible.clone()).is_ok(), "{possible:?}");
        }
        for (impossible, said) in [
            (rate().floor(Some(2900.0)), "learner.rate: measured 3,000 env-steps/s is better"),
            (cost().floor(Some(31.0)), "floor of 31.0"),
            (rate().floor(Some(f64::NAN)), "learner.rate"),
            (product().limit(Some(330.0)), "measured 1,442 GFLOP/s, the processor's peak is 330"),
        ] {
            let error = check(impossible).expect_err(said);
            assert_eq!(error.code, ExitCode::Failure);
            assert!(error.message.contains(said), "{error}");
            assert!(error.message.contains("others took 90 %"), "{error}");
        }
    }

    #[test]
    fn ratios_say_how_many_times_better() {
        let rate = Figure::rate("learner.f32.rate", "1/s", 3000.0).peer(Some(1500.0));
        let cost = Figure::cost("transport.p99_us", "µs", 50.0).peer(Some(200.0)).floor(Some(25.0));
        assert_eq!(rate.cells()[2..5], ["3,000", "1,500", "2.00×"]);
        assert_eq!(cost.cells()[2..], ["50.0", "200", "4.00×", "25.0", "50 %"]);
        let figures = Figures(vec![rate, cost]);
        let expected = serde_json::json!({
            "learner.f32.rate": 3000.0,
            "learner.f32.peer_rate": 1500.0,
            "transport.p99_us": 50.0,
            "transport.peer_p99_us": 200.0,
            "transport.floor_p99_us": 25.0,
        });
        assert_eq!(figures.to_json(), expected);
    }
}
