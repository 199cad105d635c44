//! A directory of runs: which there are, how they are at a glance, and the services of those that were asked for.

use std::collections::BTreeMap;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use axum::Router;
use proto::run_dir::RunDir;
use serde::{Deserialize, Serialize};
use store::lock::RunLock;
use store::runs::{is_run, runs_in};
use store::{regular_files, run_files};
use utoipa::ToSchema;

/// How much of the metrics' end is read for the last line (bytes).
const END: u64 = 64 * 1024;

/// Whether the run goes on.
pub(super) fn trains(run: &RunDir) -> bool {
    matches!(RunLock::holder(&run.lock()), Ok(Some(_)))
}

/// One of several runs at a glance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunAtAGlance {
    /// Name of its directory.
    pub name: String,
    /// Whether it goes on.
    pub live: bool,
    /// Iterations planned.
    pub planned_iterations: u64,
    /// The last line of its metrics; null before the first.
    #[schema(value_type = Object)]
    pub last: serde_json::Value,
    /// Its configuration.
    #[schema(value_type = Object)]
    pub config: serde_json::Value,
}

/// All runs of the directory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunList {
    /// Runs by name.
    pub runs: Vec<RunAtAGlance>,
}

/// The runs of a directory, and the services that have been asked for.
#[derive(Debug)]
pub(super) struct Runs {
    dir: PathBuf,
    services: Mutex<BTreeMap<String, Router>>,
}

impl Runs {
    pub(super) fn new(dir: PathBuf) -> Self {
        Self { dir, services: Mutex::default() }
    }

    /// The directory of a run, if there is one of that name.
    pub(super) fn run(&self, name: &str) -> Option<RunDir> {
        let is_plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\0']);
        let path = self.dir.join(name);
        (is_plain && is_run(&path)).then(|| RunDir::new(path))
    }

    /// The service of a run, which is made when it is first asked for.
    pub(super) fn service(&self, name: String, make: impl FnOnce() -> Router) -> Router {
        let mut services = self.services.lock().unwrap_or_else(PoisonError::into_inner);
        services.entry(name).or_insert_with(make).clone()
    }

    /// All of them at a glance.
    pub(super) fn list(&self) -> RunList {
        let found = runs_in(&self.dir).unwrap_or_default();
        let runs = found.iter().filter_map(|run| {
            let name = run.path().file_name()?.to_str()?;
            glance(name.to_owned(), run)
                .inspect_err(|error| tracing::debug!(%error, "a run is left out of the list"))
                .ok()
        });
        RunList { runs: runs.collect() }
    }
}

fn glance(name: String, run: &RunDir) -> anyhow::Result<RunAtAGlance> {
    let config = run_files::read_config(run)?;
    Ok(RunAtAGlance {
        name,
        live: trains(run),
        planned_iterations: config.planned_iterations(),
        last: last_line(&run.metrics_jsonl()).unwrap_or_default(),
        config: serde_json::to_value(&config)?,
    })
}

/// The last whole line of a file of JSON lines.
fn last_line(path: &Path) -> Option<serde_json::Value> {
    let mut file = regular_files::open(path).ok()?;
    let len = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(len.saturating_sub(END))).ok()?;
    let mut end = Vec::new();
    file.take(END).read_to_end(&mut end).ok()?;
    let whole = end.iter().rposition(|byte| *byte == b'\n')?;
    serde_json::from_slice(end[..whole].rsplit(|byte| *byte == b'\n').next()?).ok()
}
