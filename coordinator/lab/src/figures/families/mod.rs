//! Learning curves of several runs, those together that learn the same but for their seeds.

use std::path::PathBuf;

use output::grouped;
use proto::config::{Config, TaskName};
use proto::statistics::{Resamples, median};
use run::report::evaluations::HeldOut;
use run::report::points::Point;
use run::report::row::Row;
use run::selection::{MeanErrors, Means};
use serde::Serialize;

use super::alike::learn_alike;
use super::recorded::Recorded;

/// Points of a curve.
const POINTS: usize = 300;

/// What learning is drawn against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Over {
    /// Env-steps trained on.
    EnvSteps,
    /// Wall-clock time.
    Time,
}

impl Over {
    fn of(self, row: &impl Row) -> f64 {
        let [env_steps, wall_s, ..] = row.numbers();
        match self {
            Self::EnvSteps => env_steps,
            Self::Time => wall_s / 60.0,
        }
    }

    /// The name of its axis.
    pub(crate) fn axis(self) -> &'static str {
        match self {
            Self::EnvSteps => "env-steps",
            Self::Time => "time (min)",
        }
    }

    /// A place on its axis in words.
    fn place(self, place: f64) -> String {
        match self {
            Self::EnvSteps => grouped(place as u64),
            Self::Time => format!("{place:.1} min"),
        }
    }
}

/// What runs that differ are called.
mod names;

/// Runs that learn the same but for their seeds: `[low, mean, high]` of their mean within its 95 % bootstrap
/// interval, by [`Resamples`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Family {
    pub(crate) task: TaskName,
    /// What its curve is called: the algorithm, and the keys in which it differs from the others.
    pub(crate) name: String,
    /// The runs, with their seeds.
    pub(crate) runs: Vec<(PathBuf, u64)>,
    /// Places of `returns` on the horizontal axis.
    pub(crate) along: Vec<f64>,
    /// Return of training episodes, mean over the agents.
    pub(crate) returns: Vec<[f64; 3]>,
    /// Errors of deterministic actions; none if a run was never evaluated.
    pub held_out: Errors,
    /// Where they are as good as the paper's.
    to_paper: ToPaper,
}

/// Errors on held-out goals in the last steps of an episode.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Errors {
    /// Places on the horizontal axis.
    pub(crate) along: Vec<f64>,
    /// Of hands (mm).
    pub(crate) position: Vec<[f64; 3]>,
    /// Of hands (mrad).
    pub(crate) orientation: Vec<[f64; 3]>,
    /// Of the base (mrad).
    pub(crate) base: Vec<[f64; 3]>,
}

/// Where on the horizontal axis the held-out errors are first within the paper's, in the median over the runs; `None` if
/// that is never.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct ToPaper {
    /// By the paper's measure, the minimum over time.
    min: Option<f64>,
    /// In the last steps of an episode.
    tail: Option<f64>,
}

/// Runs of one configuration, without its seed.
struct Kind {
    config: Config,
    runs: Vec<(PathBuf, u64)>,
    points: Vec<Vec<Point>>,
    held_out: Vec<Vec<HeldOut>>,
}

/// Puts those curves together that learn the same but for their seeds; how often a run is evaluated, or what it
/// keeps, makes no difference.
pub fn families(curves: &[Recorded], over: Over) -> Vec<Family> {
    let mut kinds: Vec<Kind> = Vec::new();
    for Recorded { run, config, points, held_out, .. } in curves {
        let mut config = config.clone();
        let run = (run.clone(), std::mem::take(&mut config.run.seed));
        let at = kinds.iter().position(|kind| learn_alike(&kind.config, &config));
        let at = at.unwrap_or_else(|| {
            let (runs, points, held_out) = (Vec::new(), Vec::new(), Vec::new());
            kinds.push(Kind { config, runs, points, held_out });
            kinds.len() - 1
        });
        kinds[at].runs.push(run);
        kinds[at].points.push(points.clone());
        kinds[at].held_out.push(held_out.clone());
    }
    let configs: Vec<&Config> = kinds.iter().map(|kind| &kind.config).collect();
    let names = names::of(&configs);
    kinds.into_iter().zip(names).map(|(kind, name)| Family::new(kind, name, over)).collect()
}

impl Family {
    fn new(kind: Kind, name: String, over: Over) -> Self {
        let Kind { config, runs, points, held_out } = kind;
        let task = config.task.name;
        let along = places(&points, over);
        let returns = spanned(&points, over, &along, |point| point.mean);
        let places = places(&held_out, over);
        let errors = |read: fn(&MeanErrors) -> f64| {
            spanned(&held_out, over, &places, |at: &HeldOut| 1e3 * read(&at.errors.tail))
        };
        let errors = Errors {
            position: errors(|errors| errors.position),
            orientation: errors(|errors| errors.orientation),
            base: errors(|errors| errors.base),
            along: places.clone(),
        };
        let reached = |measure: fn(&Means) -> &MeanErrors| {
            let first = |run: &Vec<HeldOut>| {
                let good = |at: &&HeldOut| measure(&at.errors).in_papers(task) <= 1.0;
                run.iter().find(good).map_or(f64::INFINITY, |at| over.of(at))
            };
            Some(median(held_out.iter().map(first).collect())).filter(|place| place.is_finite())
        };
        let to_paper =
            ToPaper { min: reached(|errors| &errors.min), tail: reached(|errors| &errors.tail) };
        Self { task, name, runs, along, returns, held_out: errors, to_paper }
    }

    /// What the cells of a [row](Self::row) are.
    pub const HEADER: [&'static str; 9] = [
        "curve",
        "task",
        "runs",
        "return",
        "position (mm)",
        "orientation (mrad)",
        "base (mrad)",
        "minimum as the paper's",
        "last steps as the paper's",
    ];

    /// Where it ends, as a row of a table.
    pub fn row(&self, over: Over) -> [String; 9] {
        let last = |values: &[[f64; 3]]| {
            values.last().map_or_else(String::new, |[low, mean, high]| {
                format!("{mean:.1} ({low:.1} to {high:.1})")
            })
        };
        let evaluated = !self.held_out.along.is_empty();
        let reached = |place: Option<f64>| match place {
            Some(place) => over.place(place),
            None if evaluated => "never".to_owned(),
            None => String::new(),
        };
        let of_hands = |values| if self.task.reaches() { last(values) } else { String::new() };
        [
            self.name.clone(),
            self.task.as_str().to_owned(),
            self.runs.len().to_string(),
            last(&self.returns),
            of_hands(&self.held_out.position),
            of_hands(&self.held_out.orientation),
            last(&self.held_out.base),
            reached(self.to_paper.min),
            reached(self.to_paper.tail),
        ]
    }
}

/// Places where all runs have been; none if one ended before another began.
fn places<R: Row>(runs: &[Vec<R>], over: Over) -> Vec<f64> {
    let ends = |end: fn(&[R]) -> Option<&R>| -> Option<Vec<f64>> {
        runs.iter().map(|run| Some(over.of(end(run)?))).collect()
    };
    let (Some(firsts), Some(lasts)) = (ends(<[R]>::first), ends(<[R]>::last)) else {
        return Vec::new();
    };
    let first = firsts.into_iter().fold(0.0, f64::max);
    let last = lasts.into_iter().fold(f64::INFINITY, f64::min);
    if last < first {
        return Vec::new();
    }
    let at = |index: usize| first + (last - first) * index as f64 / (POINTS - 1) as f64;
    (0..POINTS).map(at).collect()
}

/// The mean over the runs of what `read` takes, with its interval, at each of `places`.
fn spanned<R: Row>(
    runs: &[Vec<R>],
    over: Over,
    places: &[f64],
    read: impl Fn(&R) -> f64,
) -> Vec<[f64; 3]> {
    let resamples = Resamples::of(runs.len());
    let at = |place: &f64| {
        let values: Vec<f64> =
            runs.iter().map(|run| interpolate(run, over, *place, &read)).collect();
        resamples.interval(&values)
    };
    places.iter().map(at).collect()
}

/// A number between the rows beside `place`.
fn interpolate<R: Row>(run: &[R], over: Over, place: f64, read: impl Fn(&R) -> f64) -> f64 {
    let next = run.partition_point(|row| over.of(row) < place);
    let after = &run[next.min(run.len() - 1)];
    let before = &run[next.saturating_sub(1)];
    let length = over.of(after) - over.of(before);
    let share = if length > 0.0 { (place - over.of(before)) / length } else { 0.0 };
    read(before) + share * (read(after) - read(before))
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;

    fn config(set: &str) -> Config {
        let layers = Layers::new(Preset::Tuned, None).set(set).expect("well formed");
        layers.resolve().expect("valid")
    }

    fn point(env_steps: f64, mean: f64) -> Point {
        let wall_s = 6.0 * env_steps;
        Point::from_numbers([env_steps, wall_s, mean, 0.0, 0.0, 0.1, 0.2, 0.3])
    }

    /// An evaluation with errors in units of the paper's.
    fn held_out(env_steps: f64, tail: f64, min: f64) -> HeldOut {
        let of = |errors: f64| [0.025 * errors, 0.04 * errors, 0.0];
        let ([a, b, c], [d, e, f]) = (of(tail), of(min));
        HeldOut::from_numbers([env_steps, 6.0 * env_steps, a, b, c, d, e, f])
    }

    fn family(held_out: &[Vec<HeldOut>; 2], over: Over) -> Family {
        let one = vec![point(10.0, 0.0), point(20.0, 1.0), point(40.0, 5.0)];
        let other = vec![point(20.0, 3.0), point(30.0, 3.0)];
        let runs = vec![("runs/a".into(), 1), ("runs/b".into(), 2)];
        let (points, held_out) = (vec![one, other], held_out.to_vec());
        let kind = Kind { config: config("run.seed=1"), runs, points, held_out };
        Family::new(kind, "mappo".to_owned(), over)
    }

    #[test]
    fn a_family_is_where_all_its_runs_have_been() {
        let time = family(&[Vec::new(), Vec::new()], Over::Time);
        assert_eq!((time.along[0], time.along[POINTS - 1]), (2.0, 3.0));
        let family = family(&[Vec::new(), vec![held_out(9.0, 1.0, 1.0)]], Over::EnvSteps);
        assert_eq!((family.along[0], family.along[POINTS - 1]), (20.0, 30.0));
        for (by_steps, by_time) in family.returns.iter().zip(&time.returns) {
            for (x, y) in by_steps.iter().zip(by_time) {
                assert!((x - y).abs() < 1e-12, "{by_steps:?} and {by_time:?}");
            }
        }
        assert_eq!(family.returns[0], [1.0, 2.0, 3.0]);
        assert_eq!(family.returns[POINTS - 1], [3.0, 3.0, 3.0]);
        assert_eq!(family.held_out, Errors::default(), "one of them was never evaluated");
        let row = family.row(Over::EnvSteps);
        assert_eq!((row[3].as_str(), row[4].as_str()), ("3.0 (3.0 to 3.0)", ""));
        assert_eq!(row[8], "", "which is not never");
    }

    #[test]
    fn runs_that_were_never_at_one_place_have_no_curve_together() {
        let ended = vec![held_out(10.0, 4.0, 4.0), held_out(20.0, 2.0, 2.0)];
        let began = vec![held_out(30.0, 3.0, 3.0), held_out(40.0, 1.0, 1.0)];
        let family = family(&[ended, began], Over::EnvSteps);
        assert_eq!(family.held_out, Errors::default());
        assert_eq!(family.to_paper.tail, None, "one of them never was as good");
    }

    #[test]
    fn held_out_errors_are_of_the_last_steps() {
        let one =
            vec![held_out(10.0, 4.0, 2.0), held_out(30.0, 2.0, 0.9), held_out(40.0, 1.0, 0.5)];
        let other = vec![held_out(10.0, 4.0, 0.9), held_out(40.0, 3.0, 0.8)];
        let family = family(&[one, other], Over::EnvSteps);
        let errors = &family.held_out;
        assert_eq!((errors.along[0], errors.along[POINTS - 1]), (10.0, 40.0));
        assert_eq!(errors.position[0], [100.0; 3]);
        for (end, expected) in errors.orientation[POINTS - 1].iter().zip([40.0, 80.0, 120.0]) {
            assert!((end - expected).abs() < 1e-9, "{:?}", errors.orientation[POINTS - 1]);
        }
        assert_eq!(family.to_paper, ToPaper { min: Some(20.0), tail: None });
        let row = family.row(Over::EnvSteps);
        assert_eq!(row[4], "50.0 (25.0 to 75.0)");
        assert_eq!((row[7].as_str(), row[8].as_str()), ("20", "never"));
    }

    #[test]
    fn the_table_fits() {
        let huge = vec![point(0.0, -1234.5), point(9e8, -1234.5)];
        let held_out = vec![held_out(0.0, 88.8, 88.8), held_out(9e8, 88.8, 0.5)];
        let runs = vec![("runs/a".into(), 1)];
        let kind = Kind {
            config: config("run.seed=1"),
            runs,
            points: vec![huge],
            held_out: vec![held_out],
        };
        let name = "mappo, hidden=[1024,1024,1024,1024…, parameter_sharing=roles".to_owned();
        let row = Family::new(kind, name, Over::EnvSteps).row(Over::EnvSteps);
        let text = output::table_within(80, Family::HEADER, [row]);
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{line}\nis too long in\n{text}");
        }
        assert!(text.contains("900,000,000") && text.contains("never"), "{text}");
    }
}
