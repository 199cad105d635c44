//! Configurations, as the command line reads them.

use std::path::{Path, PathBuf};

use proto::config::{self, Layers, Preset, TaskName};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::errors::{guarded, value};

/// Longest configuration or robot that is read (bytes).
const MAX_TEXT: u64 = 1 << 20;

/// What a run is configured with.
///
/// `config` is the name of a preset ("guided", "tuned", "paper", "release", "robust") or the path of a TOML file, which lies over `preset` ("guided"); `task` is
/// "trajectory", "reorientation", "capture" or "mixed"; `set` lists `KEY=VALUE` as `octopus train --set` takes them. `ValueError` says what is wrong, in the
/// words of `octopus train`.
#[pyclass(frozen, module = "spaceoctopus")]
#[derive(Debug)]
pub(crate) struct Config {
    pub(crate) inner: config::Config,
}

#[pymethods]
impl Config {
    #[new]
    #[pyo3(signature = (config = None, *, preset = None, task = None, set = Vec::new()))]
    fn new(
        config: Option<PathBuf>,
        preset: Option<&str>,
        task: Option<&str>,
        set: Vec<String>,
    ) -> PyResult<Self> {
        guarded(|| Ok(Self { inner: layered(config.as_deref(), preset, task, &set)? }))
    }

    /// Which task: `trajectory`, `reorientation`, `capture` or `mixed`.
    #[getter]
    fn task(&self) -> &'static str {
        self.inner.task.name.as_str()
    }

    /// Control steps of an episode.
    #[getter]
    fn episode_steps(&self) -> usize {
        self.inner.task.episode_steps
    }

    /// Duration of a control step (s).
    #[getter]
    fn control_period(&self) -> f64 {
        self.inner.env.control_period
    }

    /// Factor from a clipped action to a joint velocity command (rad/s).
    #[getter]
    fn action_scale(&self) -> f64 {
        self.inner.task.action_scale
    }

    /// The robot's name or file.
    #[getter]
    fn robot(&self) -> &str {
        &self.inner.robot.description
    }

    /// Seed of every random number.
    #[getter]
    fn seed(&self) -> u64 {
        self.inner.run.seed
    }

    /// What a run's `config.toml` says.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        guarded(|| {
            let inner = config::Config::from_resolved_toml(text, "config.toml").map_err(value)?;
            Ok(Self { inner })
        })
    }

    /// Everything, as a run's `config.toml` has it.
    fn to_toml(&self) -> String {
        self.inner.to_toml()
    }

    /// For `pickle` and `copy`.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        Ok((py.get_type::<Self>().getattr("from_toml")?, (self.to_toml(),)))
    }

    fn __repr__(&self) -> String {
        let Self { inner } = self;
        format!("Config(task={:?}, robot={:?})", inner.task.name.as_str(), inner.robot.description)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner
    }
}

/// The configuration that arguments describe.
pub(crate) fn layered(
    config: Option<&Path>,
    preset: Option<&str>,
    task: Option<&str>,
    set: &[String],
) -> PyResult<config::Config> {
    let task = match task {
        None => None,
        Some(name) => Some(
            TaskName::named(name)
                .ok_or_else(|| value(format!("task {name:?}: expected {}", TaskName::listed())))?,
        ),
    };
    let below = match preset {
        None => Preset::DEFAULT,
        Some(name) => Preset::named(name).ok_or_else(|| {
            value(format!(
                "preset {name:?}: expected \"guided\", \"tuned\", \"paper\", \"release\" or \"robust\""
            ))
        })?,
    };
    let given = config.and_then(Path::to_str).and_then(Preset::named);
    let mut layers = match (config, given) {
        (None, _) => Layers::new(below, task),
        (Some(path), Some(_)) if preset.is_some() => {
            return Err(value(format!(
                "{}: is a preset, and another one is given; name one of them, or a file",
                path.display()
            )));
        }
        (Some(_), Some(given)) => Layers::new(given, task),
        (Some(path), None) => {
            let text = read_text(path).map_err(|error| {
                value(format!(
                    "{}: {error}; give a TOML file, or one of the presets: guided, tuned, paper, release, robust",
                    path.display()
                ))
            })?;
            let origin = path.display().to_string();
            Layers::new(below, task).text(&text, &origin).map_err(value)?
        }
    };
    for assignment in set {
        layers = layers.set(assignment).map_err(value)?;
    }
    layers.resolve().map_err(value)
}

/// A configuration from what an argument `config` may be: a `Config`, or the name of a preset or a file.
pub(crate) fn of_argument(
    given: Option<&Bound<'_, PyAny>>,
    task: Option<&str>,
    set: &[String],
) -> PyResult<config::Config> {
    let Some(given) = given else { return layered(None, None, task, set) };
    if let Ok(config) = given.cast::<Config>() {
        if task.is_some() || !set.is_empty() {
            return Err(PyTypeError::new_err(
                "a Config is complete: give task and set where it is made",
            ));
        }
        return Ok(config.get().inner.clone());
    }
    let path: PathBuf = given.extract().map_err(|_| {
        PyTypeError::new_err("config: expected a Config, the name of a preset, or a path")
    })?;
    layered(Some(&path), None, task, set)
}

/// A regular file's text, if it is not overlong.
pub(crate) fn read_text(path: &Path) -> std::io::Result<String> {
    let bytes = read(path, MAX_TEXT)?;
    String::from_utf8(bytes).map_err(|_| std::io::Error::other("is no UTF-8 text"))
}

/// A regular file's bytes, `limit` at most.
pub(crate) fn read(path: &Path, limit: u64) -> std::io::Result<Vec<u8>> {
    check(path, limit)?;
    std::fs::read(path)
}

/// The length and hash of a regular file, `limit` bytes at most, which is never in memory as a whole.
pub(crate) fn hash(path: &Path, limit: u64) -> std::io::Result<(u64, blake3::Hash)> {
    check(path, limit)?;
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(std::fs::File::open(path)?)?;
    Ok((hasher.count(), hasher.finalize()))
}

/// Refuses what is no regular file of `limit` bytes at most.
fn check(path: &Path, limit: u64) -> std::io::Result<()> {
    // Asked first: opening a named pipe would wait for whoever writes to it.
    let there = std::fs::metadata(path)?;
    if !there.is_file() {
        return Err(std::io::Error::other("is no regular file"));
    }
    if there.len() > limit {
        return Err(std::io::Error::other(format!("has more than {limit} bytes")));
    }
    Ok(())
}
