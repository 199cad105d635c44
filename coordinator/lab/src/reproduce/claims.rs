//! What the paper claims, beside what was measured.
//!
//! A claim is judged by the paper's own measure, as far as it is known. Beside it stands a stricter one: the mean over the last 20 steps of all
//! episodes with held-out goals, from which no lucky moment and no easy goal can be picked.

use serde::Serialize;

use super::reports::Reports;
use crate::evaluation::Summary;
use crate::experiments::Name;
use crate::experiments::arm_failure::Failure;
use crate::experiments::base_mass::Weighed;
use crate::experiments::disturbance::Disturbance;
use crate::experiments::reassembly::Staged;
use crate::experiments::report::Goals;
use crate::statistics::{ErrorOf, Spread, Unit, thousandths};

/// Share of episodes that a mass must bring within [`MASS_THRESHOLD`], as the paper says of most masses.
pub(super) const MASS_SHARE: f64 = 0.9;
/// (rad)
pub(super) const MASS_THRESHOLD: f64 = 0.05;

/// One of the paper's claims.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Claim {
    /// Where its numbers come from.
    pub(super) experiment: Name,
    /// What it is about.
    pub(super) what: &'static str,
    /// How it is measured.
    pub(super) measure: &'static str,
    /// What the paper claims.
    pub(super) paper: Bound,
    /// What was measured; none if the robot is another one than the paper's.
    pub(super) ours: Option<f64>,
    /// Whether that satisfies the claim.
    pub(super) holds: Option<bool>,
    /// The same by stricter measures.
    pub(super) stricter: Vec<Stricter>,
    /// The trial that shows it, as it is called where its first episode is kept.
    #[serde(skip)]
    pub(super) episode: Option<String>,
}

/// A number that a claim says is not passed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Bound {
    /// An error below this (m).
    BelowMetres(f64),
    /// An error below this (rad).
    BelowRadians(f64),
    /// Of so many cases more than half.
    MostOf(usize),
}

/// A stricter measure of the same.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Stricter {
    pub(super) measure: &'static str,
    pub(super) value: f64,
    /// Whether it satisfies the claim, too.
    pub(super) holds: bool,
}

impl Bound {
    fn below(unit: Unit, value: f64) -> Self {
        match unit {
            Unit::Metre => Self::BelowMetres(value),
            Unit::Radian => Self::BelowRadians(value),
        }
    }

    /// Whether `value` keeps it.
    fn holds(self, value: f64) -> bool {
        match self {
            Self::BelowMetres(bound) | Self::BelowRadians(bound) => value < bound,
            Self::MostOf(cases) => 2.0 * value > cases as f64,
        }
    }

    /// A value as it is compared with this.
    pub(super) fn show(self, value: f64) -> String {
        match self {
            Self::BelowMetres(_) => format!("{:.1} mm", 1e3 * value),
            Self::BelowRadians(_) => format!("{:.1} mrad", 1e3 * value),
            Self::MostOf(cases) => format!("{value:.0} of {cases}"),
        }
    }

    /// What is claimed.
    pub(super) fn text(self) -> String {
        match self {
            Self::BelowMetres(bound) => format!("< {} mm", (1e4 * bound).round() / 10.0),
            Self::BelowRadians(bound) => format!("< {} mrad", (1e4 * bound).round() / 10.0),
            Self::MostOf(cases) => format!("most of {cases}"),
        }
    }
}

impl Claim {
    fn new(
        experiment: Name,
        what: &'static str,
        measure: &'static str,
        paper: Bound,
        ours: Option<f64>,
    ) -> Self {
        let holds = ours.map(|value| paper.holds(value));
        Self { experiment, what, measure, paper, ours, holds, stricter: Vec::new(), episode: None }
    }

    fn shown_by(self, episode: impl Into<String>) -> Self {
        Self { episode: Some(episode.into()), ..self }
    }

    fn stricter(mut self, measure: &'static str, value: Option<f64>) -> Self {
        // Nothing is measured where there was nothing to measure, such as goals that can be reached.
        let stricter = value.filter(|value| !value.is_nan()).map(|value| Stricter {
            measure,
            value,
            holds: self.paper.holds(value),
        });
        self.stricter.extend(stricter);
        self
    }
}

/// All of them.
pub(super) fn claims(reports: &Reports) -> Vec<Claim> {
    let mut claims = precision(reports);
    claims.extend(disturbance(reports));
    claims.push(arm_failure(reports));
    claims.push(base_mass(reports));
    claims.extend(reassembly(reports));
    claims
}

/// What the released script measures: the minimum over time, mean over episodes (and hands).
fn precision(reports: &Reports) -> Vec<Claim> {
    let mut claims = Vec::new();
    for result in &reports.precision.results {
        let Summary { overall, reachable, .. } = &result.summary;
        for error in overall {
            let what = match error.error {
                ErrorOf::Position => "trajectory, position",
                ErrorOf::Orientation => "trajectory, orientation",
                ErrorOf::Base => "reorientation",
            };
            let bound = error.error.papers();
            let ours = Some(error.min.mean);
            let measure = "mean of the minima over time";
            let paper = Bound::below(error.unit, bound);
            let claim = Claim::new(Name::Precision, what, measure, paper, ours)
                .shown_by(result.trial())
                .stricter("last 20 steps, all goals", Some(error.tail.mean));
            let same = reachable.as_ref().and_then(|reachable| {
                let mut all = reachable.subset.overall.iter();
                all.find(|other| other.error == error.error).map(|other| other.tail.mean)
            });
            claims.push(claim.stricter("last 20 steps, goals that can be reached", same));
        }
    }
    claims
}

/// What the paper's figure shows: one episode, disturbed by overwritten actions. Each axis is below at its end.
fn disturbance(reports: &Reports) -> Vec<Claim> {
    let mut claims = Vec::new();
    let results = &reports.disturbance.results;
    for result in results.iter().filter(|result| result.disturbance == Disturbance::Override) {
        for error in &result.errors {
            let last = result.figure.as_ref().and_then(|figure| {
                let hand = figure.hands.first();
                let axes = match error.error {
                    ErrorOf::Position => hand?.position_m.last(),
                    ErrorOf::Orientation => hand?.orientation_rad.last(),
                    ErrorOf::Base => figure.base_rad.last(),
                };
                axes.map(largest)
            });
            let what = match error.error {
                ErrorOf::Position => "disturbed trajectory, position",
                ErrorOf::Orientation => "disturbed trajectory, orientation",
                ErrorOf::Base => "disturbed reorientation",
            };
            let measure = "worst axis after the last step, the authors' goals";
            let paper = Bound::below(error.unit, thousandths(error.threshold));
            claims.push(
                Claim::new(Name::Disturbance, what, measure, paper, last)
                    .shown_by(result.trial(Goals::Theirs))
                    .stricter("worst axis, last 20 steps, held-out goals", Some(error.tail.mean)),
            );
        }
    }
    claims
}

/// The largest of three axes.
fn largest(axes: &[f32; 3]) -> f64 {
    f64::from(axes.iter().fold(0.0_f32, |largest, axis| largest.max(axis.abs())))
}

fn arm_failure(reports: &Reports) -> Claim {
    let failed = |failure| {
        let mut results = reports.arm_failure.results.iter();
        results.find(|result| result.failure == failure)
    };
    let held = failed(Failure::Held);
    let norm = |[x, y, z]: &[f32; 3]| f64::from((x * x + y * y + z * z).sqrt());
    let last = held.and_then(|held| held.figure.base_rad.last().map(norm));
    let tail = |failure| failed(failure).map(|result| result.error.tail.mean);
    let measure = "after the last step, the authors' goal, arm held";
    let bound = Bound::BelowRadians(0.03);
    Claim::new(Name::ArmFailure, "reorientation, one arm failed", measure, bound, last)
        .shown_by(held.map_or_else(String::new, |held| held.trial(Goals::Theirs)))
        .stricter("last 20 steps, held-out goals, arm held", tail(Failure::Held))
        .stricter("last 20 steps, held-out goals, arm limp", tail(Failure::Limp))
}

fn base_mass(reports: &Reports) -> Claim {
    let report = &reports.base_mass;
    let thresholds = &report.protocol.settings.thresholds_rad;
    let cases = report.results.len();
    let within = |threshold: f64| {
        let place = thresholds.iter().position(|other| *other == threshold)?;
        let reached = report.results.iter().filter(|result| result.success[place] >= MASS_SHARE);
        Some(reached.count() as f64)
    };
    // Nine tenths of the episodes stay below their 90th percentile.
    let tails = report.results.iter().map(|result| result.error.tail.p90);
    let steady = tails.filter(|tail| *tail < MASS_THRESHOLD).count() as f64;
    let measure = "masses of which 90 % of the episodes end within 50 mrad";
    let what = "reorientation, other masses";
    let lightest = report.results.first().map_or_else(String::new, Weighed::trial);
    Claim::new(Name::BaseMass, what, measure, Bound::MostOf(cases), within(MASS_THRESHOLD))
        .shown_by(lightest)
        .stricter("90 % within 30 mrad", within(0.03))
        .stricter("90 % within 50 mrad in the last 20 steps", Some(steady))
}

/// What the paper's figures show: one episode of each stage, at its end; the worst hand of both stages.
fn reassembly(reports: &Reports) -> Vec<Claim> {
    let of = |goals: Goals, error: ErrorOf, read: fn(&Spread) -> f64, last| {
        let stages = reports.reassembly.results.iter().filter(|stage| stage.goals == goals);
        let errors = stages.flat_map(|stage| &stage.errors).filter(|other| other.error == error);
        errors.map(|error| read(if last { &error.last } else { &error.tail })).reduce(f64::max)
    };
    let claim = |error: ErrorOf, what, bound| {
        let last = of(Goals::Theirs, error, |spread| spread.mean, true);
        let tail = of(Goals::HeldOut, error, |spread| spread.mean, false);
        let measure = "worst of both stages after the last step, the authors' goals";
        // Of the worst stage.
        let theirs = reports.reassembly.results.iter().filter(|stage| stage.goals == Goals::Theirs);
        let worst = |stage: &&Staged| {
            let of = stage.errors.iter().filter(|other| other.error == error);
            of.map(|error| error.last.mean).fold(f64::NEG_INFINITY, f64::max)
        };
        let shown = theirs.max_by(|a, b| worst(a).total_cmp(&worst(b))).map(Staged::trial);
        Claim::new(Name::Reassembly, what, measure, Bound::below(error.unit(), bound), last)
            .shown_by(shown.unwrap_or_default())
            .stricter("worst of both, last 20 steps, held-out goals", tail)
    };
    vec![
        claim(ErrorOf::Position, "reassembly, position", 0.04),
        claim(ErrorOf::Orientation, "reassembly, orientation", 0.045),
        claim(ErrorOf::Base, "reassembly, base", 0.035),
    ]
}

/// How many claims hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// Claims that hold.
    pub hold: usize,
    /// All claims.
    pub of: usize,
    not_judged: usize,
}

impl Tally {
    /// Counts.
    pub fn of(claims: &[Claim]) -> Self {
        let count = |holds| claims.iter().filter(|claim| claim.holds == holds).count();
        Self { hold: count(Some(true)), of: claims.len(), not_judged: count(None) }
    }

    /// How many claims say nothing about this robot; empty if all are judged.
    pub fn not_judged(self) -> String {
        match self.not_judged {
            0 => String::new(),
            n => format!(", {n} not judged"),
        }
    }
}

/// The claims as a person reads them.
pub fn table(columns: usize, claims: &[Claim]) -> String {
    let rows = claims.iter().map(|claim| {
        let strict = claim.stricter.iter().map(|stricter| claim.paper.show(stricter.value));
        [
            claim.what.to_owned(),
            claim.paper.text(),
            claim.ours.map_or("–".to_owned(), |ours| claim.paper.show(ours)),
            verdict(claim.holds).to_owned(),
            strict.collect::<Vec<_>>().join(" / "),
        ]
    });
    output::table_within(columns, ["claim", "paper", "ours", "", "stricter"], rows)
}

/// A judgement in a word.
pub(super) fn verdict(holds: Option<bool>) -> &'static str {
    match holds {
        Some(true) => "holds",
        Some(false) => "fails",
        None => "not judged",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_strict_and_most_is_more_than_half() {
        assert!(Bound::BelowMetres(0.025).holds(0.0249));
        assert!(!Bound::BelowMetres(0.025).holds(0.025));
        assert!(!Bound::BelowRadians(0.03).holds(f64::NAN));
        assert!(!Bound::MostOf(10).holds(5.0));
        assert!(Bound::MostOf(10).holds(6.0));
        assert!(Bound::MostOf(5).holds(3.0));
        assert_eq!(Bound::BelowRadians(0.045).text(), "< 45 mrad");
        assert_eq!(Bound::below(Unit::Metre, 0.025).show(0.0131), "13.1 mm");
        assert_eq!(Bound::MostOf(10).show(8.0), "8 of 10");
        assert_eq!(Bound::MostOf(10).text(), "most of 10");
    }

    #[test]
    fn what_is_not_judged_does_not_hold() {
        let claim = |ours| {
            let bound = Bound::BelowRadians(0.03);
            Claim::new(Name::ArmFailure, "what", "measure", bound, ours)
        };
        let tally = Tally::of(&[claim(Some(0.01)), claim(Some(0.05)), claim(None)]);
        assert_eq!((tally.hold, tally.of), (1, 3));
        assert_eq!(tally.not_judged(), ", 1 not judged");
        assert_eq!(Tally::of(&[claim(Some(0.01))]).not_judged(), "");
        assert!(claim(Some(0.01)).stricter("none to measure", Some(f64::NAN)).stricter.is_empty());
    }

    #[test]
    fn claims_of_measured_numbers() {
        let reports = super::super::reports::tests::reports();
        let claims = claims(reports);
        let names: Vec<_> = claims.iter().map(|claim| claim.what).collect();
        assert_eq!(names.len(), 11, "{names:?}");
        let find = |what: &str| claims.iter().find(|claim| claim.what == what).expect(what);
        // A robot that rests: what it measures is the distance of the goals from home.
        let position = find("trajectory, position");
        let summary = &reports.precision.results[0].summary;
        assert_eq!(position.ours, Some(summary.overall[0].min.mean));
        assert_eq!(position.holds, Some(false), "goals are decimetres away");
        assert_eq!(position.stricter.len(), 2, "all goals, and those that can be reached");
        // The authors' goal of the base: 0.02927, -0.03531, 0.19579 rad from home.
        let base = find("disturbed reorientation");
        assert!((base.ours.expect("four arms") - 0.19579).abs() < 0.11, "{base:?}");
        assert_eq!(base.paper, Bound::BelowRadians(0.03));
        // (-0.10385, 0.08410, 0.13543) rad: its norm.
        let failed = find("reorientation, one arm failed");
        assert!((failed.ours.expect("held") - 0.1902).abs() < 1e-3, "{failed:?}");
        assert_eq!(failed.stricter.len(), 2);
        let mass = find("reorientation, other masses");
        assert_eq!((mass.paper, mass.stricter.len()), (Bound::MostOf(2), 2));
        let text = table(200, &claims);
        assert_eq!(text.lines().count(), 12);
        assert!(text.contains("fails") && text.contains("< 25 mm"), "{text}");
    }
}
