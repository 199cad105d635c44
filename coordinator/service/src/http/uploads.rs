//! Uploads of checkpoints as tar archives.

use std::fs::File;
use std::io::BufReader;
use std::io::Seek as _;
use std::path::Path;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::response::IntoResponse as _;
use axum::response::Response;
use store::checkpoint::{CheckpointError, Entry, Name, UPLOAD};
use tokio::io::AsyncWriteExt as _;
use tokio::sync::OwnedSemaphorePermit;

use super::context::{Context, Shared, blocking};
use super::document::Bytes;
use super::params::Params;
use super::problem::{ErrorBody, Problem};
use super::request_body::RequestBody;
use super::upload_space;

/// Buffer between the file and the reader of archives (bytes).
const BUFFER: usize = 1 << 20;
/// Bytes that are taken in between two looks at the room on the disk.
const CHECKED: u64 = 8 << 20;

/// Takes a checkpoint in, from an archive as `/archive` gives it. It appears whole or not at all.
#[utoipa::path(put, path = "/v1/checkpoints/{name}", tag = "checkpoints",
    params(("name" = String, Path, description = "Name that it gets here")),
    request_body(content = inline(Bytes), content_type = "application/x-tar"),
    responses(
        (status = 200, description = "The same checkpoint was there already", body = Entry),
        (status = 201, description = "Taken in", body = Entry),
        (status = 400, description = "Not a name, or the body ended early", body = ErrorBody),
        (status = 408, description = "The body came too slowly", body = ErrorBody),
        (status = 404, description = "The store is gone", body = ErrorBody),
        (status = 409, description = "Another checkpoint has this name", body = ErrorBody),
        (status = 413, description = "Larger than the service takes", body = ErrorBody),
        (status = 422, description = "Not an archive of a checkpoint", body = ErrorBody),
        (status = 503, description = "Too many at once; try again", body = ErrorBody),
        (status = 507, description = "Too little room would be left on the disk, or uploads take \
            enough of it already", body = ErrorBody),
    )
)]
pub(super) async fn upload(
    State(context): State<Shared>,
    Params(name): Params<String>,
    request: Request,
) -> Result<Response, Problem> {
    let limit = context.upload_limit().await?;
    let mut intake = RequestBody::new(request, limit, &context.limits);
    let (name, file, place) = match receive(&context, &name, &mut intake).await {
        Ok(received) => received,
        Err(problem) => {
            intake.discard().await;
            return Err(problem);
        }
    };
    // One at a time, so that it is clear which of two of the same name was first.
    let _turn = context.import.lock().await;
    let store = context.store.clone();
    let (status, entry) = blocking(move || {
        let there = store.entry(&name).is_ok();
        let entry = store.import(BufReader::with_capacity(BUFFER, file), Some(name))?;
        // Until here, also if the client has gone meanwhile: what waits for its turn is on the disk.
        drop(place);
        Ok((if there { StatusCode::OK } else { StatusCode::CREATED }, entry))
    })
    .await?
    .map_err(refusal)?;
    Ok((status, Json(entry)).into_response())
}

/// Takes the body in, into a file that nobody else sees, and a place among the uploads.
async fn receive(
    context: &Context,
    name: &str,
    intake: &mut RequestBody,
) -> Result<(Name, File, OwnedSemaphorePermit), Problem> {
    let name: Name = name.parse().map_err(CheckpointError::from)?;
    let wanted = name.clone();
    context.with_store(move |store| store.check_free(&wanted)).await?;
    intake.check_announced()?;
    let place = context.places.uploads.take()?;
    let root = context.store.root().to_owned();
    // The archive, and what is in it.
    check_room(context, intake.announced().unwrap_or(0).saturating_mul(2)).await?;
    let failure = {
        let root = root.clone();
        move |source| Problem::from(CheckpointError::Io { path: root, action: "write", source })
    };
    let file = blocking(move || nameless(&root)).await?.map_err(failure.clone())?;
    let mut file = tokio::fs::File::from_std(file);
    let mut unchecked = 0;
    while let Some(bytes) = intake.next().await? {
        file.write_all(&bytes).await.map_err(failure.clone())?;
        unchecked += bytes.len() as u64;
        if unchecked >= CHECKED {
            unchecked = 0;
            check_room(context, intake.taken()).await?;
        }
    }
    file.flush().await.map_err(failure.clone())?;
    check_room(context, intake.taken()).await?;
    let mut file = file.into_std().await;
    file.rewind().map_err(failure)?;
    Ok((name, file, place))
}

/// Refuses the upload if it needs more bytes than may be taken from the disk.
async fn check_room(context: &Context, needed: u64) -> Result<(), Problem> {
    let (root, reserve) = (context.store.root().to_owned(), context.limits.disk_reserve);
    blocking(move || upload_space::check(&root, needed, reserve)).await?
}

/// What is damaged here is what the client sent.
fn refusal(error: CheckpointError) -> Problem {
    match error {
        CheckpointError::Damaged { .. } | CheckpointError::Config(_) => {
            let message = format!("not an archive of a whole checkpoint: {error}");
            Problem::new(StatusCode::UNPROCESSABLE_ENTITY, message)
        }
        error => error.into(),
    }
}

/// A new file on the disk of `root` that loses its name at once: however this ends, the system frees
/// it. A process that is killed in between leaves it, empty, to a sweep of the store.
fn nameless(root: &Path) -> std::io::Result<File> {
    std::fs::create_dir_all(root)?;
    Ok(tempfile::Builder::new().prefix(UPLOAD).tempfile_in(root)?.into_file())
}
