//! Learning curves of runs in one small file, which takes the runs' place in pictures.

use std::path::{Path, PathBuf};

use proto::config::Config;
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::commands::{read_config, run_directory};
use crate::files;
use crate::report::curve::{Point, read_points, thin_out};
use crate::report::jsonl;

/// Points that a file keeps of a curve, at most.
const POINTS: usize = 130;
/// Significant digits that it keeps of a measured number.
const DIGITS: usize = 4;
/// Longest file that is read (bytes).
const MOST_BYTES: u64 = 64 << 20;

/// The curve of one run, and what it came from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Recorded {
    /// Name of the run's directory.
    pub(crate) run: PathBuf,
    /// The commit that its program was built from.
    commit: Option<String>,
    /// The processor that it ran on.
    processor: Option<String>,
    /// Digest of the training state after the last iteration.
    digest: Option<String>,
    /// Its resolved configuration.
    pub(crate) config: Config,
    /// What was measured.
    #[serde(with = "columns")]
    pub(crate) points: Vec<Point>,
}

/// A file of curves.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    curves: Vec<Recorded>,
}

impl Recorded {
    /// The whole curve of the run in a directory.
    fn of_run(path: &Path) -> anyhow::Result<Self> {
        let run_dir = run_directory(path)?;
        let config = read_config(&run_dir)?;
        let metrics = run_dir.metrics_jsonl();
        let points = read_points(&metrics)?;
        if points.len() < 2 {
            let message = format!("{}: has no two iterations; there is no curve", path.display());
            return Err(ExitError::new(ExitCode::RunDirectory, message).into());
        }
        let last = jsonl::read(&metrics)?.pop().map(|(_, line)| line);
        let digest = last.and_then(|line| Some(line["digest"].as_str()?.to_owned()));
        let provenance = std::fs::read(run_dir.provenance()).unwrap_or_default();
        let provenance: Value = serde_json::from_slice(&provenance).unwrap_or_default();
        let session = provenance["sessions"].as_array().and_then(|sessions| sessions.last());
        let said = |key: &str| Some(session?[key].as_str()?.to_owned());
        let (commit, processor) = (said("commit"), said("processor"));
        let run = path.file_name().unwrap_or(path.as_os_str()).into();
        Ok(Self { run, commit, processor, digest, config, points })
    }

    /// Refuses what is no curve.
    fn check(&self) -> Result<(), String> {
        let name = self.run.display();
        self.config.validate().map_err(|error| format!("{name}: {error}"))?;
        let finite = |point: &Point| point.numbers().iter().all(|number| number.is_finite());
        if self.points.len() < 2 || !self.points.iter().all(finite) {
            return Err(format!("{name}: wants two points or more, all of finite numbers"));
        }
        let along =
            |of: fn(&Point) -> f64| self.points.windows(2).all(|pair| of(&pair[0]) <= of(&pair[1]));
        if !along(|point| point.env_steps) || !along(|point| point.wall_s) {
            return Err(format!("{name}: env_steps and wall_s must not fall"));
        }
        Ok(())
    }
}

/// The curve of a run directory, or the curves of a file that [`write`] made.
pub(crate) fn read(path: &Path) -> anyhow::Result<Vec<Recorded>> {
    if !path.is_file() {
        return Ok(vec![Recorded::of_run(path)?]);
    }
    let refuse = |what: String| {
        let message = format!(
            "{}: {what}; wanted: a run directory, or a file made by `octopus plot --save`",
            path.display()
        );
        ExitError::new(ExitCode::BadInput, message)
    };
    let length = path.metadata().map_err(|error| refuse(error.to_string()))?.len();
    if length > MOST_BYTES {
        return Err(refuse(format!("has {length} bytes, more than {MOST_BYTES}")).into());
    }
    let bytes = std::fs::read(path).map_err(|error| refuse(error.to_string()))?;
    let content: Content = serde_json::from_slice(&bytes)
        .map_err(|error| refuse(format!("is no file of curves ({error})")))?;
    for curve in &content.curves {
        curve.check().map_err(&refuse)?;
    }
    Ok(content.curves)
}

/// Writes curves into one file, thinned out and rounded.
pub(crate) fn write(path: &Path, curves: &[Recorded]) -> anyhow::Result<()> {
    let small = |curve: &Recorded| {
        let mut points = thin_out(&curve.points, POINTS);
        for point in &mut points {
            *point = Point::from_numbers(point.numbers().map(rounded));
        }
        Recorded { points, ..curve.clone() }
    };
    let content = Content { curves: curves.iter().map(small).collect() };
    files::replace_output(path, &serde_json::to_vec(&content)?)?;
    Ok(())
}

/// A number with [`DIGITS`] significant digits; env-steps and the like, which are larger, as a whole number.
fn rounded(value: f64) -> f64 {
    if value.abs() >= 10_f64.powi(DIGITS as i32) {
        return value.round();
    }
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}

/// Points as an object of columns, in which a file is a third as long as with an object a point.
mod columns {
    use std::collections::BTreeMap;

    use serde::de::Error as _;
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer};

    use super::Point;

    pub(super) fn serialize<S: Serializer>(points: &[Point], to: S) -> Result<S::Ok, S::Error> {
        let column = |(index, name): (usize, &&'static str)| {
            (*name, points.iter().map(|point| point.numbers()[index]).collect::<Vec<f64>>())
        };
        Point::NAMES.iter().enumerate().map(column).collect::<BTreeMap<_, _>>().serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Point>, D::Error> {
        let mut columns = BTreeMap::<String, Vec<f64>>::deserialize(from)?;
        let mut of = |name: &&str| {
            columns.remove(*name).ok_or_else(|| D::Error::custom(format!("no column {name}")))
        };
        let values = Point::NAMES.iter().map(&mut of).collect::<Result<Vec<_>, _>>()?;
        if let Some(name) = columns.keys().next() {
            return Err(D::Error::custom(format!("unknown column {name}")));
        }
        let len = values[0].len();
        if values.iter().any(|column| column.len() != len) {
            return Err(D::Error::custom("the columns have different lengths"));
        }
        let point =
            |at: usize| Point::from_numbers(std::array::from_fn(|column| values[column][at]));
        Ok((0..len).map(point).collect())
    }
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset, TaskName};
    use serde_json::json;

    use super::*;

    fn curve(points: usize) -> Recorded {
        let point = |k: usize| {
            Point::from_numbers([
                6400.0 * (k + 1) as f64,
                1.23456 * k as f64,
                -1.0 / 3.0,
                -2.0,
                1.0,
                0.1,
                0.2,
                0.3,
            ])
        };
        Recorded {
            run: "mappo-1".into(),
            commit: Some("abc".to_owned()),
            processor: None,
            digest: None,
            config: Layers::new(Preset::Tuned, Some(TaskName::Trajectory))
                .resolve()
                .expect("valid"),
            points: (0..points).map(point).collect(),
        }
    }

    fn written(curves: &[Recorded]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("curves.json");
        write(&path, curves).expect("written");
        (dir, path)
    }

    #[test]
    fn a_file_holds_what_was_written_thinned_out_and_rounded() {
        let (_dir, path) = written(&[curve(400), curve(20)]);
        let read = read(&path).expect("whole");
        assert_eq!((read[0].points.len(), read[1].points.len()), (100, 20));
        assert_eq!(read[1].config, curve(2).config);
        assert_eq!(
            read[1].points[3].numbers(),
            [25_600.0, 3.704, -0.3333, -2.0, 1.0, 0.1, 0.2, 0.3]
        );
        assert_eq!(read[0].points[0].env_steps, 16_000.0, "the mean of four");
    }

    #[test]
    fn what_is_no_file_of_curves_is_refused_by_name() {
        let (_dir, path) = written(&[curve(3)]);
        let whole: Value =
            serde_json::from_slice(&std::fs::read(&path).expect("there")).expect("JSON");
        let refused = |change: &dyn Fn(&mut Value), word: &str| {
            let mut changed = whole.clone();
            change(&mut changed["curves"][0]);
            std::fs::write(&path, changed.to_string()).expect("written");
            let error = read(&path).expect_err(word);
            let message = error.to_string();
            assert!(message.contains(word) && message.contains("curves.json"), "{message}");
            assert_eq!(
                error.downcast_ref::<ExitError>().map(|error| error.code),
                Some(ExitCode::BadInput)
            );
        };
        refused(&|curve| curve["points"]["wall_s"] = json!([1.0]), "different lengths");
        refused(&|curve| curve["points"]["wall_s"] = json!([3.0, 2.0, 1.0]), "must not fall");
        refused(&|curve| curve["points"]["more"] = json!([1.0]), "unknown column more");
        refused(&|curve| curve["points"] = json!({}), "no column env_steps");
        refused(&|curve| curve["points"]["base"] = json!([0.1, null, 0.1]), "null");
        refused(&|curve| curve["config"]["env"]["n_envs"] = json!(0), "n_envs");
        refused(&|curve| curve["colour"] = json!(1), "colour");
        std::fs::write(&path, &serde_json::to_vec(&whole).expect("JSON")[..100]).expect("written");
        assert!(read(&path).expect_err("cut").to_string().contains("is no file of curves"));
    }
}
