//! Learning curves of several runs, those together that learn the same but for their seeds.

use std::path::PathBuf;

use clap::ValueEnum;
use proto::config::{AlgorithmName, Config, TaskName};
use serde::Serialize;

use super::recorded::Recorded;
use crate::report::curve::Point;

/// Points of a curve.
const POINTS: usize = 300;

/// What learning is drawn against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Over {
    /// Env-steps trained on.
    EnvSteps,
    /// Wall-clock time.
    Time,
}

impl Over {
    fn of(self, point: &Point) -> f64 {
        match self {
            Self::EnvSteps => point.env_steps,
            Self::Time => point.wall_s / 60.0,
        }
    }

    /// The name of its axis.
    pub(crate) fn axis(self) -> &'static str {
        match self {
            Self::EnvSteps => "env-steps",
            Self::Time => "time (min)",
        }
    }
}

/// Runs that learn the same but for their seeds; `[low, mean, high]` over them at every one of `along`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Family {
    pub(crate) task: TaskName,
    algorithm: AlgorithmName,
    /// The runs, with their seeds.
    pub(crate) runs: Vec<(PathBuf, u64)>,
    /// Places on the horizontal axis.
    pub(crate) along: Vec<f64>,
    pub(crate) returns: Vec<[f64; 3]>,
    /// (mm)
    pub(crate) position: Vec<[f64; 3]>,
    /// (mrad)
    pub(crate) orientation: Vec<[f64; 3]>,
    /// (mrad)
    pub(crate) base: Vec<[f64; 3]>,
}

/// Runs of one configuration, without its seed.
struct Kind {
    config: Config,
    runs: Vec<(PathBuf, u64)>,
    curves: Vec<Vec<Point>>,
}

/// Puts those curves together that learn the same but for their seeds; how often a run is evaluated, or what it
/// keeps, makes no difference.
pub(crate) fn families(curves: &[Recorded], over: Over) -> Vec<Family> {
    let mut kinds: Vec<Kind> = Vec::new();
    for Recorded { run, config, points, .. } in curves {
        let mut config = config.clone();
        let (run, points) = ((run.clone(), std::mem::take(&mut config.run.seed)), points.clone());
        match kinds.iter_mut().find(|kind| learn_alike(&kind.config, &config)) {
            Some(kind) => {
                kind.runs.push(run);
                kind.curves.push(points);
            }
            None => kinds.push(Kind { config, runs: vec![run], curves: vec![points] }),
        }
    }
    let family = |Kind { config, runs, curves }: Kind| {
        Family::new(config.task.name, config.algorithm.name, runs, &curves, over)
    };
    kinds.into_iter().map(family).collect()
}

/// Whether two configurations differ in what does not change what is learned, at most.
fn learn_alike(one: &Config, other: &Config) -> bool {
    // The budget does: the learning rate falls over it.
    one.run.continues(&other.run)
        && one.run.env_steps == other.run.env_steps
        && *one == Config { run: one.run.clone(), ..other.clone() }
}

impl Family {
    fn new(
        task: TaskName,
        algorithm: AlgorithmName,
        runs: Vec<(PathBuf, u64)>,
        curves: &[Vec<Point>],
        over: Over,
    ) -> Self {
        let ends = |end: fn(&[Point]) -> Option<&Point>| {
            curves.iter().filter_map(move |curve| Some(over.of(end(curve)?)))
        };
        // Where all runs have been.
        let first = ends(<[Point]>::first).fold(0.0, f64::max);
        let last = ends(<[Point]>::last).fold(f64::INFINITY, f64::min);
        let at = |index: usize| first + (last - first) * index as f64 / (POINTS - 1) as f64;
        let along: Vec<f64> = (0..POINTS).map(at).collect();
        let spanned = |read: fn(&Point) -> f64| -> Vec<[f64; 3]> {
            let at = |place: &f64| {
                let values = curves.iter().map(|curve| interpolate(curve, over, *place, read));
                let (low, sum, high) = values.fold(
                    (f64::INFINITY, 0.0, f64::NEG_INFINITY),
                    |(low, sum, high): (f64, f64, f64), value| {
                        (low.min(value), sum + value, high.max(value))
                    },
                );
                [low, sum / curves.len() as f64, high]
            };
            along.iter().map(at).collect()
        };
        Self {
            task,
            algorithm,
            runs,
            returns: spanned(|point| point.mean),
            position: spanned(|point| 1e3 * point.position),
            orientation: spanned(|point| 1e3 * point.orientation),
            base: spanned(|point| 1e3 * point.base),
            along,
        }
    }

    /// What its curve is called.
    pub(crate) fn name(&self) -> String {
        let first = self.runs.first().and_then(|(path, _)| path.file_name()).unwrap_or_default();
        match self.runs.len() {
            1 => format!("{}: {}", self.algorithm.as_str(), first.to_string_lossy()),
            n => format!(
                "{}: {} and {} more",
                self.algorithm.as_str(),
                first.to_string_lossy(),
                n - 1
            ),
        }
    }
}

/// A number between the iterations beside `place`.
fn interpolate(curve: &[Point], over: Over, place: f64, read: fn(&Point) -> f64) -> f64 {
    let next = curve.partition_point(|point| over.of(point) < place);
    let after = &curve[next.min(curve.len() - 1)];
    let before = &curve[next.saturating_sub(1)];
    let length = over.of(after) - over.of(before);
    let share = if length > 0.0 { (place - over.of(before)) / length } else { 0.0 };
    read(before) + share * (read(after) - read(before))
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;

    fn point(env_steps: f64, mean: f64) -> Point {
        let wall_s = 6.0 * env_steps;
        let (low, high, position, orientation, base) = (0.0, 0.0, 0.1, 0.2, 0.3);
        Point { env_steps, wall_s, mean, low, high, position, orientation, base }
    }

    #[test]
    fn seeds_and_housekeeping_alone_make_no_other_family() {
        let config = |set: &str| {
            let layers = Layers::new(Preset::Tuned, None).set(set).expect("well formed");
            layers.resolve().expect("valid")
        };
        let plain = config("run.seed=1");
        for alike in ["run.keep_every=7", "run.checkpoint_every=3", "run.evaluate_every=1"] {
            assert!(learn_alike(&config(alike), &plain), "{alike}");
        }
        for other in ["run.env_steps=9_000_000", "run.overlap=0", "algorithm.gamma=0.5"] {
            assert!(!learn_alike(&config(other), &plain), "{other}");
        }
    }

    #[test]
    fn a_family_is_where_all_its_runs_have_been() {
        let one = vec![point(10.0, 0.0), point(20.0, 1.0), point(40.0, 5.0)];
        let other = vec![point(20.0, 3.0), point(30.0, 3.0)];
        let runs = vec![("runs/a".into(), 1), ("runs/b".into(), 2)];
        let curves = [one, other];
        let over = |over| {
            let runs = runs.clone();
            Family::new(TaskName::Trajectory, AlgorithmName::Mappo, runs, &curves, over)
        };
        let time = over(Over::Time);
        assert_eq!((time.along[0], time.along[POINTS - 1]), (2.0, 3.0));
        let family = over(Over::EnvSteps);
        assert_eq!((family.along[0], family.along[POINTS - 1]), (20.0, 30.0));
        for (by_steps, by_time) in family.returns.iter().zip(&time.returns) {
            for (x, y) in by_steps.iter().zip(by_time) {
                assert!((x - y).abs() < 1e-12, "{by_steps:?} and {by_time:?}");
            }
        }
        assert_eq!(family.returns[0], [1.0, 2.0, 3.0]);
        assert_eq!(family.returns[POINTS - 1], [3.0, 3.0, 3.0]);
        assert!((family.position[0][1] - 100.0).abs() < 1e-9);
        assert_eq!(family.name(), "mappo: a and 1 more");
    }
}
