//! What a live run says and can be asked: `/v1/status`, `/v1/workers`, a checkpoint now.

use axum::Json;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse as _, Response};
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;
use utoipa::ToSchema;

use super::context::{Context, Shared};
use super::problem::{ErrorBody, Problem};
use super::request_body::RequestBody;
use crate::live::{Command, LiveStatus};

/// How many workers a run shall have.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ScaleRequest {
    /// Workers wanted; at most the run's limit. None only where other machines may help.
    pub workers: usize,
    /// Name or number of the other machine that shall have them; this one, if it is not there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub host: Option<String>,
}

/// How many workers a run has been told to have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ScaleAnswer {
    /// Workers wanted from now on.
    pub workers: usize,
    /// Workers wanted before.
    pub before: usize,
}

/// What became of a request to commit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CommitAnswer {
    /// Name of the new checkpoint; none while the iteration is still being trained on.
    pub checkpoint: Option<String>,
}

/// What the live run is doing.
#[utoipa::path(get, path = "/v1/status", tag = "run", responses(
    (status = 200, description = "What it is doing", body = LiveStatus),
    (status = 404, description = "This service stands beside no run", body = ErrorBody),
))]
pub(super) async fn status(State(context): State<Shared>) -> Result<Json<LiveStatus>, Problem> {
    Ok(Json(context.live()?.status()))
}

/// Changes the number of workers; what is learned does not change.
#[utoipa::path(put, path = "/v1/workers", tag = "run", request_body = ScaleRequest, responses(
    (status = 200, description = "Done", body = ScaleAnswer),
    (status = 404, description = "This service stands beside no run", body = ErrorBody),
    (status = 408, description = "The body came too slowly", body = ErrorBody),
    (status = 409, description = "The run cannot do this now", body = ErrorBody),
    (status = 413, description = "The body is larger than the service takes", body = ErrorBody),
    (status = 415, description = "The body is not `application/json`", body = ErrorBody),
    (status = 422, description = "Not a number of workers that the run can have", body = ErrorBody),
    (status = 504, description = "The run did not answer in time", body = ErrorBody),
))]
pub(super) async fn scale(
    State(context): State<Shared>,
    request: Request,
) -> Result<Json<ScaleAnswer>, Problem> {
    let live = context.live()?;
    let limits = &context.limits;
    let wish: ScaleRequest = RequestBody::new(request, limits.json_bytes, limits).json().await?;
    let workers = wish.workers;
    let status = live.status();
    let refuse = |message| Problem::new(StatusCode::UNPROCESSABLE_ENTITY, message);
    let host = wish.host.as_deref().map(|host| status.host(host)).transpose().map_err(refuse)?;
    let (least, most) = match host {
        Some(host) => (1, host.max_workers),
        None => (status.min_workers, status.max_workers),
    };
    // A run that has not begun to speak has no limit yet, and refuses itself.
    if workers < least || (most > 0 && workers > most) {
        return Err(refuse(format!("{workers} workers, expected {least} to {}", most.max(1))));
    }
    let host = host.map(|host| host.host);
    let answer = ask(&context, |reply| match host {
        Some(host) => Command::ScaleHost { host, workers, reply },
        None => Command::Scale { workers, reply },
    })
    .await?;
    let before = answer.ok_or_else(|| {
        Problem::new(
            StatusCode::GATEWAY_TIMEOUT,
            "the run has not answered in time; it may still do it: see /v1/status",
        )
    })?;
    Ok(Json(ScaleAnswer { workers, before }))
}

/// Has the live run commit a checkpoint after the iteration that is being trained on.
#[utoipa::path(post, path = "/v1/checkpoints", tag = "run", responses(
    (status = 200, description = "Committed", body = CommitAnswer),
    (status = 202, description = "Will be committed; the iteration is a long one", body = CommitAnswer),
    (status = 404, description = "This service stands beside no run", body = ErrorBody),
    (status = 409, description = "The run cannot do this now", body = ErrorBody),
))]
pub(super) async fn commit(State(context): State<Shared>) -> Result<Response, Problem> {
    let checkpoint = ask(&context, |reply| Command::Checkpoint { reply }).await?;
    let status = if checkpoint.is_some() { StatusCode::OK } else { StatusCode::ACCEPTED };
    Ok((status, Json(CommitAnswer { checkpoint })).into_response())
}

/// Asks the live run for something; `None` if it has not answered in time.
async fn ask<T>(
    context: &Context,
    command: impl FnOnce(oneshot::Sender<Result<T, String>>) -> Command,
) -> Result<Option<T>, Problem> {
    let (reply, answer) = oneshot::channel();
    context.live()?.ask(command(reply));
    match tokio::time::timeout(context.limits.command_time, answer).await {
        Ok(Ok(Ok(value))) => Ok(Some(value)),
        Ok(Ok(Err(reason))) => Err(Problem::new(StatusCode::CONFLICT, reason)),
        Ok(Err(_)) => {
            Err(Problem::new(StatusCode::CONFLICT, "the run is ending and takes no more requests"))
        }
        Err(_) => Ok(None),
    }
}
