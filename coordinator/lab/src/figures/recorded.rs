//! Learning curves of runs in one small file, which takes the runs' place in pictures.

use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use proto::config::Config;
use proto::{ExitCode, ExitError};
use run::report::evaluations::{self, HeldOut};
use run::report::points::{Point, read_points, thin_out};
use run::report::row::Row;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use store::jsonl;
use store::run_files::{read_config, run_directory};
use store::{files, regular_files};

use super::alike::learn_alike;

/// Points that a file keeps of a curve, at most.
const POINTS: usize = 130;
/// Significant digits that it keeps of a measured number.
const DIGITS: usize = 4;
/// Longest file that is read (bytes).
const MOST_BYTES: u64 = 64 << 20;

/// The curve of one run, and what it came from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recorded {
    /// Name of the run's directory.
    pub run: PathBuf,
    /// The commit that its program was built from.
    commit: Option<String>,
    /// The processor that it ran on.
    processor: Option<String>,
    /// Digest of the training state after the last iteration.
    digest: Option<String>,
    /// Its resolved configuration.
    pub config: Config,
    /// What was measured while it trained.
    #[serde(with = "columns")]
    pub points: Vec<Point>,
    /// What its evaluations on held-out goals say; nothing, where none was made.
    #[serde(with = "columns")]
    pub held_out: Vec<HeldOut>,
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
        let held_out = evaluations::read(&run_dir.evaluations())?;
        let last = jsonl::read(&metrics)?.pop().map(|(_, line)| line);
        let digest = last.and_then(|line| Some(line["digest"].as_str()?.to_owned()));
        let provenance =
            regular_files::read(&run_dir.provenance(), regular_files::RECORD).unwrap_or_default();
        let provenance: Value = serde_json::from_slice(&provenance).unwrap_or_default();
        let session = provenance["sessions"].as_array().and_then(|sessions| sessions.last());
        let said = |key: &str| Some(session?[key].as_str()?.to_owned());
        let (commit, processor) = (said("commit"), said("processor"));
        let run = path.file_name().unwrap_or(path.as_os_str()).into();
        Ok(Self { run, commit, processor, digest, config, points, held_out })
    }

    /// Env-steps at its end.
    fn end(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.env_steps)
    }

    /// Whether it tells of the same bits: the state at the end is the same, or, where that is not known of both, everything on which
    /// it depends. A copy of a run, or its repetition, says nothing about other seeds.
    fn is_same_training(&self, other: &Self) -> bool {
        if self.config.run.seed != other.config.run.seed
            || !learn_alike(&self.config, &other.config)
        {
            return false;
        }
        if let (Some(one), Some(another)) = (&self.digest, &other.digest)
            && self.end() == other.end()
        {
            return one == another;
        }
        let known = |one: &Option<String>, other: &Option<String>| one.is_some() && one == other;
        let on_cpu = self.config.run.device == "cpu" && other.config.run.device == "cpu";
        known(&self.digest, &other.digest)
            || (on_cpu
                && known(&self.commit, &other.commit)
                && known(&self.processor, &other.processor))
    }

    /// Refuses what is no curve.
    fn check(&self) -> Result<(), String> {
        let name = self.run.display();
        self.config.validate().map_err(|error| format!("{name}: {error}"))?;
        if self.points.len() < 2 {
            return Err(format!("{name}: wants two points or more"));
        }
        check_rows(&self.points)
            .and_then(|()| check_rows(&self.held_out))
            .map_err(|error| format!("{name}: {error}"))
    }
}

/// Refuses numbers that are not finite, and rows that go back.
fn check_rows<R: Row>(rows: &[R]) -> Result<(), String> {
    let rows: Vec<_> = rows.iter().map(Row::numbers).collect();
    if !rows.iter().flatten().all(|number| number.is_finite()) {
        return Err("wants finite numbers".to_owned());
    }
    if rows.windows(2).any(|pair| pair[0][0] > pair[1][0] || pair[0][1] > pair[1][1]) {
        return Err("env_steps and wall_s must not fall".to_owned());
    }
    Ok(())
}

/// The curves of run directories and of files that [`write()`] made, each training once; and what is to be said of those
/// that were given twice.
pub fn read_all(paths: &[PathBuf]) -> anyhow::Result<(Vec<Recorded>, Vec<String>)> {
    let mut curves: Vec<Recorded> = Vec::new();
    let mut notes = Vec::new();
    let mut places = Vec::new();
    for path in paths {
        let found = read(path)?;
        let place = path.metadata().map(|there| (there.dev(), there.ino()))?;
        if places.contains(&place) {
            notes.push(format!("note: {} is given twice and counts once", path.display()));
            continue;
        }
        places.push(place);
        for curve in found {
            let Some(same) = curves.iter_mut().find(|other| other.is_same_training(&curve)) else {
                curves.push(curve);
                continue;
            };
            notes.push(format!(
                "note: {} is the same training as {} ({}, seed {}) and counts once",
                curve.run.display(),
                same.run.display(),
                curve.config.algorithm.name.as_str(),
                curve.config.run.seed
            ));
            // One of them may have been recorded before the training was over.
            if curve.points.len() > same.points.len() && curve.end() > same.end() {
                *same = curve;
            }
        }
    }
    Ok((curves, notes))
}

/// The curve of a run directory, or the curves of a file that [`write()`] made.
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
    let bytes = regular_files::read(path, MOST_BYTES).map_err(|error| refuse(error.to_string()))?;
    Ok(parse(&bytes).map_err(refuse)?)
}

/// The curves in the bytes of a file, or what is wrong with them.
pub fn parse(bytes: &[u8]) -> Result<Vec<Recorded>, String> {
    let content: Content =
        serde_json::from_slice(bytes).map_err(|error| format!("is no file of curves ({error})"))?;
    content.curves.iter().try_for_each(Recorded::check)?;
    Ok(content.curves)
}

/// Writes curves into one file, thinned out and rounded.
pub fn write(path: &Path, curves: &[Recorded]) -> anyhow::Result<()> {
    let small = |curve: &Recorded| {
        let points = shortened(&thin_out(&curve.points, POINTS));
        Recorded { points, held_out: shortened(&curve.held_out), ..curve.clone() }
    };
    let curves: Vec<Recorded> = curves.iter().map(small).collect();
    files::replace_output(path, &to_json(&curves)?)?;
    Ok(())
}

/// A file of these curves, as they are.
pub fn to_json(curves: &[Recorded]) -> anyhow::Result<Vec<u8>> {
    Ok(serde_json::to_vec(&Content { curves: curves.to_vec() })?)
}

/// Rows of shorter numbers.
fn shortened<R: Row>(rows: &[R]) -> Vec<R> {
    rows.iter().map(|row| R::from_numbers(row.numbers().map(rounded))).collect()
}

/// A number with [`DIGITS`] significant digits; env-steps and the like, which are larger, as a whole number.
fn rounded(value: f64) -> f64 {
    if value.abs() >= 10_f64.powi(DIGITS as i32) {
        return value.round();
    }
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}

/// Rows as an object of columns, in which a file is a third as long as with an object a row.
mod columns {
    use std::collections::BTreeMap;

    use serde::de::Error as _;
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer};

    use super::Row;

    pub(super) fn serialize<R: Row, S: Serializer>(rows: &[R], to: S) -> Result<S::Ok, S::Error> {
        let column = |(index, name): (usize, &&'static str)| {
            (*name, rows.iter().map(|row| row.numbers()[index]).collect::<Vec<f64>>())
        };
        R::NAMES.iter().enumerate().map(column).collect::<BTreeMap<_, _>>().serialize(to)
    }

    pub(super) fn deserialize<'de, R: Row, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Vec<R>, D::Error> {
        let mut columns = BTreeMap::<String, Vec<f64>>::deserialize(from)?;
        let mut of = |name: &&str| {
            columns.remove(*name).ok_or_else(|| D::Error::custom(format!("no column {name}")))
        };
        let values = R::NAMES.iter().map(&mut of).collect::<Result<Vec<_>, _>>()?;
        if let Some(name) = columns.keys().next() {
            return Err(D::Error::custom(format!("unknown column {name}")));
        }
        let len = values[0].len();
        if values.iter().any(|column| column.len() != len) {
            return Err(D::Error::custom("the columns have different lengths"));
        }
        let row = |at: usize| R::from_numbers(std::array::from_fn(|column| values[column][at]));
        Ok((0..len).map(row).collect())
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
            held_out: [20.0, 30.0]
                .map(|at| HeldOut::from_numbers([at, at, 0.012_345_6, 0.02, 0.0, 0.01, 0.01, 0.0]))
                .to_vec(),
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
        assert_eq!(
            read[1].held_out[1].numbers(),
            [30.0, 30.0, 0.01235, 0.02, 0.0, 0.01, 0.01, 0.0]
        );
    }

    #[test]
    fn a_training_that_is_given_twice_counts_once() {
        let seeded = |seed: u64, points: usize, commit: &str| {
            let mut curve = curve(points);
            curve.config.run.seed = seed;
            curve.commit = Some(commit.to_owned());
            curve.processor = Some("Xeon".to_owned());
            curve
        };
        let later = seeded(1, 30, "abc");
        let (_one, one) = written(&[seeded(1, 20, "abc"), seeded(2, 20, "abc")]);
        let (_two, two) = written(&[later.clone(), seeded(1, 20, "def")]);
        let (curves, notes) = read_all(&[one.clone(), two, one]).expect("whole");
        let found: Vec<_> = curves
            .iter()
            .map(|curve| (curve.config.run.seed, curve.points.len(), curve.commit.as_deref()))
            .collect();
        let expected = [(1, 30, Some("abc")), (2, 20, Some("abc")), (1, 20, Some("def"))];
        assert_eq!(found, expected, "the longer one of two, and another build is another training");
        assert_eq!(notes.len(), 2, "{notes:?}");
        assert!(notes[0].contains("the same training as mappo-1 (mappo, seed 1)"), "{notes:?}");
        assert!(notes[1].contains("curves.json is given twice"), "{notes:?}");
        // Without a word on build and processor the state at the end tells.
        let ended = |digest: &str| Recorded { digest: Some(digest.to_owned()), ..curve(20) };
        assert!(ended("aa").is_same_training(&ended("aa")));
        assert!(!ended("aa").is_same_training(&Recorded { commit: None, ..ended("bb") }));
        // Two states at the same end are two trainings, of whatever build: it may have been changed since its commit.
        let built = |digest: &str| Recorded { processor: Some("Xeon".to_owned()), ..ended(digest) };
        assert!(!built("aa").is_same_training(&built("bb")));
        assert!(
            built("aa").is_same_training(&Recorded { points: curve(30).points, ..built("bb") })
        );
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
        refused(&|curve| curve["held_out"]["env_steps"] = json!([2.0, 1.0]), "must not fall");
        refused(&|curve| curve["held_out"] = json!(null), "null");
        refused(&|curve| curve["points"]["more"] = json!([1.0]), "unknown column more");
        refused(&|curve| curve["points"] = json!({}), "no column env_steps");
        refused(&|curve| curve["points"]["base"] = json!([0.1, null, 0.1]), "null");
        refused(&|curve| curve["config"]["env"]["n_envs"] = json!(0), "n_envs");
        refused(&|curve| curve["colour"] = json!(1), "colour");
        std::fs::write(&path, &serde_json::to_vec(&whole).expect("JSON")[..100]).expect("written");
        assert!(read(&path).expect_err("cut").to_string().contains("is no file of curves"));
    }
}
