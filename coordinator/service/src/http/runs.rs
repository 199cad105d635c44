//! All runs of a directory, each with a service of its own below `/runs/NAME/`, for looking only.

use std::collections::BTreeMap;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use axum::extract::{Request, State};
use axum::http::uri::PathAndQuery;
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse as _, Response};
use axum::{Json, Router};
use proto::run_dir::RunDir;
use serde::{Deserialize, Serialize};
use store::checkpoint::CheckpointStore;
use store::lock::RunLock;
use store::{regular_files, run_files};
use tower::ServiceExt as _;
use utoipa::ToSchema;

use super::context::{Context, Shared, blocking};
use super::page;
use super::problem::{ErrorBody, Problem};
use super::router::router;

/// How much of the metrics' end is read for the last line (bytes).
const END: u64 = 64 * 1024;

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
    fn run(&self, name: &str) -> Option<RunDir> {
        let plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\0']);
        let run = RunDir::new(self.dir.join(name));
        (plain && run.config().is_file()).then_some(run)
    }

    fn list(&self) -> RunList {
        let entries = std::fs::read_dir(&self.dir).into_iter().flatten().flatten();
        let mut names: Vec<String> =
            entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        let runs = names.into_iter().filter_map(|name| {
            let run = self.run(&name)?;
            glance(name, &run)
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
        live: matches!(RunLock::holder(&run.lock()), Ok(Some(_))),
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

/// All runs of the directory that is served.
#[utoipa::path(get, path = "/v1/runs", tag = "run", operation_id = "list_runs", responses(
    (status = 200, description = "All of them", body = RunList),
    (status = 404, description = "This service is of one run or store", body = ErrorBody),
))]
pub(super) async fn list(State(context): State<Shared>) -> Result<Json<RunList>, Problem> {
    runs_of(&context)?;
    let list = blocking(move || context.runs.as_ref().map(Runs::list)).await?;
    Ok(Json(list.unwrap_or(RunList { runs: Vec::new() })))
}

/// The service of one run, with all paths of this document below its own.
#[utoipa::path(get, path = "/runs/{run}/{path}", tag = "run", operation_id = "of_one_run",
    params(
        ("run" = String, Path, description = "Name of the run"),
        ("path" = String, Path, description = "A path of this document without its first `/`"),
    ),
    responses(
        (status = 200, description = "As that path says", body = String),
        (status = 404, description = "No such run, or this service is of one run or store", body = ErrorBody),
    )
)]
pub(super) async fn one(
    State(context): State<Shared>,
    request: Request,
) -> Result<Response, Problem> {
    let (name, path) = inner(request.uri()).ok_or_else(|| absent("no run"))?;
    if crate::page::is_at(path.path()) {
        // Without the token nothing is said of the run, not even whether there is one.
        return page::at(path.path(), request.method(), request.headers());
    }
    let runs = runs_of(&context)?;
    let run = runs.run(&name).ok_or_else(|| absent(&name))?;
    let service = {
        let mut services = runs.services.lock().unwrap_or_else(PoisonError::into_inner);
        services
            .entry(name)
            .or_insert_with(|| {
                let store = CheckpointStore::new(run.checkpoints());
                router(Arc::new(context.of_one_run(store)))
            })
            .clone()
    };
    let mut request = request;
    *request.uri_mut() = Uri::from(path);
    // The variable parts of the outer path are none of the inner one.
    request.extensions_mut().clear();
    Ok(service.oneshot(request).await.into_response())
}

/// The name of the run and the path in its service.
fn inner(uri: &Uri) -> Option<(String, PathAndQuery)> {
    let rest = uri.path_and_query()?.as_str().strip_prefix("/runs/")?;
    let (name, _) = rest.split_once('/')?;
    // Names that would need escaping are none that `octopus` gives.
    let path = rest[name.len()..].parse().ok()?;
    Some((name.to_owned(), path))
}

fn absent(name: &str) -> Problem {
    let message = format!("`{}`: no such run here; GET /v1/runs lists them", name.escape_debug());
    Problem::new(StatusCode::NOT_FOUND, message)
}

fn runs_of(context: &Context) -> Result<&Runs, Problem> {
    context.runs.as_ref().ok_or_else(|| {
        let message = "this service is of one run or store; `octopus serve --runs DIR` serves all of a directory";
        Problem::new(StatusCode::NOT_FOUND, message)
    })
}
