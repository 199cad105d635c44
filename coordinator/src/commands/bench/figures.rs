//! The figures of a measurement, as a table and as JSON.

use serde_json::{Map, Value};

use crate::output;
use crate::report::progress::grouped;

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
}

impl Figure {
    /// More is better.
    pub(super) fn rate(key: impl Into<String>, unit: &'static str, value: f64) -> Self {
        Self { key: key.into(), unit, value, sense: Sense::Rate, peer: None, floor: None }
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
