//! Downloads of whole checkpoints as tar archives.

use std::io;

use axum::body::Body;
use axum::extract::State;
use axum::http::Method;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse as _, Response};
use store::checkpoint::CheckpointError;

use super::bodies::{pipe, unknown};
use super::checkpoints;
use super::context::Shared;
use super::document::Bytes;
use super::params::Params;
use super::problem::{ErrorBody, Problem};

/// Media type of an archive.
const TAR: &str = "application/x-tar";

/// Downloads a checkpoint as a tar archive. A connection that ends before the body does means that
/// something went wrong here; what arrived is no archive then.
#[utoipa::path(get, path = "/v1/checkpoints/{name}/archive", tag = "checkpoints",
    operation_id = "download_archive",
    params(("name" = String, Path, description = "Name, tag, `latest` or `best`")),
    responses(
        (status = 200, description = "The archive", body = inline(Bytes),
            content_type = "application/x-tar", headers(("octopus-passed-over" = String,
                description = "Newer ones than `latest` that are damaged"))),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint", body = ErrorBody),
        (status = 500, description = "It is damaged", body = ErrorBody),
        (status = 503, description = "Too many at once; try again", body = ErrorBody),
    )
)]
pub(super) async fn download(
    State(context): State<Shared>,
    Params(name): Params<String>,
    method: Method,
) -> Result<Response, Problem> {
    let choice = context
        .with_checked(move |store, checked| checkpoints::find(store, checked, &name))
        .await?;
    let passed_over = choice.header();
    let entry = choice.entry;
    let disposition = format!("attachment; filename=\"{}.tar\"", entry.name);
    let headers = [(CONTENT_TYPE, TAR.to_owned()), (CONTENT_DISPOSITION, disposition)];
    if method == Method::HEAD {
        return Ok((passed_over, headers, unknown()).into_response());
    }
    let place = context.places.archives.take()?;
    let store = context.store.clone();
    let (mut writer, body) = pipe();
    tokio::task::spawn_blocking(move || {
        let result = store.export(&entry.name, &mut writer);
        if let Err(error) = &result {
            tracing::debug!(%error, "an archive was cut short");
        }
        writer.finish(result.map_err(io::Error::other));
        drop(place);
    });
    // The store checks a checkpoint before it writes the first byte, so damage is told in time.
    match body.started().await {
        Ok(body) => Ok((passed_over, headers, Body::new(body)).into_response()),
        Err(error) => Err(match error.downcast::<CheckpointError>() {
            Ok(error) => error.into(),
            Err(error) => Problem::internal(&error),
        }),
    }
}
