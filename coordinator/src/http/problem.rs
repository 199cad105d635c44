//! What went wrong, as a client sees it.

use std::io::ErrorKind;

use axum::Json;
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::checkpoint::CheckpointError;

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
    fn from(error: CheckpointError) -> Self {
        let status = match &error {
            CheckpointError::NotFound { .. } => StatusCode::NOT_FOUND,
            CheckpointError::Name(_) => StatusCode::BAD_REQUEST,
            CheckpointError::Conflict { .. } | CheckpointError::Pinned { .. } => {
                StatusCode::CONFLICT
            }
            CheckpointError::Refused { .. } | CheckpointError::Archive { .. } => {
                StatusCode::UNPROCESSABLE_ENTITY
            }
            CheckpointError::Io { source, .. } => match source.kind() {
                // Removed by somebody else meanwhile.
                ErrorKind::NotFound => StatusCode::NOT_FOUND,
                ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
                    StatusCode::INSUFFICIENT_STORAGE
                }
                _ => return Self::internal(&error),
            },
            CheckpointError::Damaged { .. } => {
                let cure = "GET /v1/checkpoints lists the others; `octopus checkpoints verify` \
                            says what is wrong with it";
                return Self::new(
                    StatusCode::INTERNAL_SERVER_ERROR,
                    format!("the checkpoint is damaged: {error}; {cure}"),
                );
            }
            _ => return Self::internal(&error),
        };
        Self::new(status, error.to_string())
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = (self.status, Json(ErrorBody { error: self.message })).into_response();
        response.headers_mut().extend(self.headers);
        response
    }
}
