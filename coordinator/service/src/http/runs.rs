//! All runs of a directory, each with a service of its own below `/runs/NAME/`, for looking only.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::CONTENT_LENGTH;
use axum::http::uri::PathAndQuery;
use axum::http::{Method, StatusCode, Uri};
use axum::response::{IntoResponse as _, Response};
use axum::{Extension, Json, Router};
use serde::Deserialize;
use store::checkpoint::CheckpointStore;
use tower::ServiceExt as _;

use super::bodies::unknown;
use super::context::{Context, Shared, blocking};
use super::page;
use super::params::Params;
use super::problem::{ErrorBody, Problem};
use super::run_directory::{RunList, Runs};

/// What makes the service of one run: the routes know it, and give it along.
#[derive(Debug, Clone, Copy)]
pub(super) struct Serve(pub(super) fn(Shared) -> Router);

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

/// The service of one run, which stands beside no live one, with all paths of this document below its own. All but the page
/// need the token, `health` too: strangers are not told which runs there are.
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
    Extension(Serve(serve)): Extension<Serve>,
    Params(Named { run: name }): Params<Named>,
    request: Request,
) -> Result<Response, Problem> {
    let path = inner(request.uri()).ok_or_else(|| absent(&name))?;
    if crate::page::is_at(path.path()) {
        // Without the token nothing is said of the run, not even whether there is one.
        return page::at(path.path(), request.headers());
    }
    let runs = runs_of(&context)?;
    let run = runs.run(&name).ok_or_else(|| absent(&name))?;
    let service = runs.service(name, || {
        let store = CheckpointStore::new(run.checkpoints());
        serve(Arc::new(context.of_one_run(store)))
    });
    let is_head = request.method() == Method::HEAD;
    let mut request = request;
    *request.uri_mut() = Uri::from(path);
    // The variable parts of the outer path are none of the inner one.
    request.extensions_mut().clear();
    let mut response = service.oneshot(request).await.into_response();
    // Its router has taken the content out, and ours would take what is left for all of it.
    if is_head && !response.headers().contains_key(CONTENT_LENGTH) {
        *response.body_mut() = unknown();
    }
    Ok(response)
}

/// Of the variable parts of a path the name of the run, decoded: trials of a sweep have `=` and `,` in theirs, which
/// clients escape.
#[derive(Debug, Deserialize)]
pub(super) struct Named {
    run: String,
}

/// The path in the service of the run.
fn inner(uri: &Uri) -> Option<PathAndQuery> {
    let rest = uri.path_and_query()?.as_str().strip_prefix("/runs/")?;
    rest[rest.find('/')?..].parse().ok()
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
