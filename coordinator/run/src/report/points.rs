//! Points of a learning curve, as `metrics.jsonl` has them.

use std::path::Path;

use serde_json::Value;
use store::jsonl;

use super::row::Row;

/// One iteration on the curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Env-steps trained on.
    pub env_steps: f64,
    /// Time since the run began (s).
    pub wall_s: f64,
    /// Mean return over agents.
    pub mean: f64,
    /// Smallest mean return of an agent.
    pub low: f64,
    /// Largest mean return of an agent.
    pub high: f64,
    /// Position error of hands (m).
    pub position: f64,
    /// Orientation error of hands (rad).
    pub orientation: f64,
    /// Attitude error of the base (rad).
    pub base: f64,
}

impl Row for Point {
    const NAMES: [&'static str; 8] = [
        "env_steps",
        "wall_s",
        "return_mean",
        "return_low",
        "return_high",
        "position",
        "orientation",
        "base",
    ];

    fn numbers(&self) -> [f64; 8] {
        let Self { env_steps, wall_s, mean, low, high, position, orientation, base } = *self;
        [env_steps, wall_s, mean, low, high, position, orientation, base]
    }

    fn from_numbers(numbers: [f64; 8]) -> Self {
        let [env_steps, wall_s, mean, low, high, position, orientation, base] = numbers;
        Self { env_steps, wall_s, mean, low, high, position, orientation, base }
    }
}

/// Reads the points of a `metrics.jsonl`; lines with a number that is not finite are left out.
pub fn read_points(path: &Path) -> anyhow::Result<Vec<Point>> {
    let point = |line: &Value| {
        let returns: Option<Vec<f64>> =
            line["returns"].as_array()?.iter().map(Value::as_f64).collect();
        let returns = returns?;
        Some(Point {
            env_steps: line["env_steps"].as_f64()?,
            wall_s: line["wall_s"].as_f64()?,
            mean: line["return_mean"].as_f64()?,
            low: returns.iter().copied().fold(f64::INFINITY, f64::min),
            high: returns.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            position: line["errors"]["position"].as_f64()?,
            orientation: line["errors"]["orientation"].as_f64()?,
            base: line["errors"]["base"].as_f64()?,
        })
    };
    Ok(jsonl::read(path)?.iter().filter_map(|(_, line)| point(line)).collect())
}

/// Means of neighbours, so that at most `most` remain.
pub fn thin_out(points: &[Point], most: usize) -> Vec<Point> {
    let group = points.len().div_ceil(most).max(1);
    let mean = |group: &[Point]| {
        let mut sums = [0.0; Point::NAMES.len()];
        for point in group {
            for (sum, number) in sums.iter_mut().zip(point.numbers()) {
                *sum += number;
            }
        }
        Point::from_numbers(sums.map(|sum| sum / group.len() as f64))
    };
    points.chunks(group).map(mean).collect()
}
