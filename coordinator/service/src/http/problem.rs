//! What went wrong, as a client sees it.

use std::io::ErrorKind;
use std::path::Path;

use axum::Json;
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use store::checkpoint::{CONFIG, CheckpointError, LABELS, MANIFEST, POLICY, ROBOT, STATE, newest};
use utoipa::ToSchema;

/// Body of every answer that is no success.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ErrorBody {
    /// What is wrong, what was expected, and what to do.
    pub error: String,
}

/// A failure with its status code.
#[derive(Debug)]
pub(super) struct Problem {
    pub(super) status: StatusCode,
    pub(super) message: String,
    headers: Vec<(HeaderName, HeaderValue)>,
}

impl Problem {
    pub(super) fn new(status: StatusCode, message: impl Into<String>) -> Self {
        Self { status, message: message.into(), headers: Vec::new() }
    }

    /// Adds a header to the answer.
    pub(super) fn with(mut self, name: HeaderName, value: HeaderValue) -> Self {
        self.headers.push((name, value));
        self
    }

    /// Something failed here that no client can help; the log says more than the client is told.
    pub(super) fn internal(error: &dyn std::fmt::Display) -> Self {
        tracing::error!(%error, "a request failed");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string())
    }

    /// Too much at once; the client may try again.
    pub(super) fn busy(message: &str) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, message)
            .with(axum::http::header::RETRY_AFTER, HeaderValue::from_static("1"))
    }
}

impl From<CheckpointError> for Problem {
    /// Says it as a client sees it: no paths of this machine, and routes instead of commands.
    fn from(error: CheckpointError) -> Self {
        match &error {
            CheckpointError::Absent { name, .. } => Self::new(
                StatusCode::NOT_FOUND,
                format!("no checkpoint `{name}` here; GET /v1/checkpoints lists what is"),
            ),
            CheckpointError::NotFound { what, .. } => Self::new(StatusCode::NOT_FOUND, what),
            CheckpointError::Name(_) => Self::new(StatusCode::BAD_REQUEST, error.to_string()),
            CheckpointError::Conflict { path, reason } => {
                Self::new(StatusCode::CONFLICT, format!("`{}` {reason}", shown(path)))
            }
            CheckpointError::Pinned { path } => {
                let name = shown(path);
                let cure = format!("`DELETE /v1/checkpoints/{name}/pin` lets it go");
                Self::new(StatusCode::CONFLICT, format!("`{name}` is pinned; {cure}"))
            }
            CheckpointError::Newest { path, live } => {
                let reason = newest(*live, "this service does not remove it");
                Self::new(StatusCode::CONFLICT, format!("`{}` {reason}", shown(path)))
            }
            CheckpointError::Refused { .. } | CheckpointError::Archive { .. } => {
                Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string())
            }
            CheckpointError::Locked { .. } => Self::busy(
                "another program has been changing the store for too long; nothing was changed; try \
                 again in a moment",
            ),
            CheckpointError::Io { path, action, source } => {
                let message = format!("{}: cannot {action}: {source}", shown(path));
                match source.kind() {
                    // Removed by somebody else meanwhile.
                    ErrorKind::NotFound => Self::new(StatusCode::NOT_FOUND, message),
                    ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
                        Self::new(StatusCode::INSUFFICIENT_STORAGE, message)
                    }
                    _ => Self { message, ..Self::internal(&error) },
                }
            }
            CheckpointError::Damaged { path, reason } => {
                tracing::debug!(%error, "a damaged checkpoint was asked for");
                let message = format!(
                    "the checkpoint is damaged: {}: {reason}; GET /v1/checkpoints lists the others",
                    shown(path)
                );
                Self::new(StatusCode::INTERNAL_SERVER_ERROR, message)
            }
            CheckpointError::Config(_) => {
                let message = "the checkpoint's configuration cannot be read; the log says why";
                Self { message: message.to_owned(), ..Self::internal(&error) }
            }
        }
    }
}

/// A path of the store without the place of the store: a checkpoint, or a file of one.
fn shown(path: &Path) -> String {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let is_file = [MANIFEST, STATE, POLICY, CONFIG, ROBOT, LABELS].contains(&&*name(path));
    match path.parent() {
        Some(dir) if is_file => format!("{}/{}", name(dir), name(path)),
        _ => name(path),
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = (self.status, Json(ErrorBody { error: self.message })).into_response();
        response.headers_mut().extend(self.headers);
        response
    }
}
