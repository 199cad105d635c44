//! Downloads of single files, whole or in part.

use std::fs::File;
use std::path::Path;

use axum::body::Body;
use axum::extract::State;
use axum::http::header::{
    ACCEPT_RANGES, CACHE_CONTROL, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG,
};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::response::{IntoResponse as _, Response};
use store::checkpoint::{Checked, CheckpointError, MANIFEST, Manifest};

use super::bodies::FileBody;
use super::checkpoints;
use super::context::Shared;
use super::document::Bytes;
use super::params::Params;
use super::problem::{ErrorBody, Problem};
use super::ranges::{self, Selection};

/// A file to send: open, so that it is whole even if the checkpoint is removed meanwhile.
struct Found {
    file: File,
    len: u64,
    blake3: String,
}

/// Downloads one file. The entity tag is its BLAKE3.
#[utoipa::path(get, path = "/v1/checkpoints/{name}/files/{file}", tag = "checkpoints",
    operation_id = "download_file",
    params(
        ("name" = String, Path, description = "Name, tag, `latest` or `best`"),
        ("file" = String, Path, description = "As listed in the manifest, or `manifest.json`"),
        ("range" = Option<String>, Header, description = "`bytes=first-last`"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The whole file", body = inline(Bytes),
            content_type = "application/octet-stream",
            headers(("etag" = String), ("accept-ranges" = String),
                ("octopus-passed-over" = String,
                    description = "Newer ones than `latest` that are damaged"))),
        (status = 206, description = "The range asked for", body = inline(Bytes),
            content_type = "application/octet-stream", headers(("content-range" = String))),
        (status = 304, description = "The client has it"),
        (status = 400, description = "Not a name", body = ErrorBody),
        (status = 404, description = "No such checkpoint or file", body = ErrorBody),
        (status = 412, description = "Not what If-Match names", body = ErrorBody),
        (status = 416, description = "The file has no such bytes", body = ErrorBody),
        (status = 500, description = "The file is damaged", body = ErrorBody),
    )
)]
pub(super) async fn download(
    State(context): State<Shared>,
    Params((name, file)): Params<(String, String)>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let wanted = file.clone();
    let (passed_over, found) = context
        .with_checked(move |store, checked| {
            let choice = checkpoints::find(store, checked, &name)?;
            Ok((choice.header(), open(&choice.entry.dir, &wanted, checked)?))
        })
        .await?;
    let Some(Found { file: opened, len, blake3 }) = found else {
        let message = format!(
            "the checkpoint has no file `{file}`; GET /v1/checkpoints/NAME lists its files"
        );
        return Err(Problem::new(StatusCode::NOT_FOUND, message));
    };
    let etag = format!("\"{blake3}\"");
    let selection = ranges::select(&method, &headers, &etag, len)?;
    // The same name may once hold another checkpoint, so caches ask each time.
    let common = [
        (ETAG, etag),
        (ACCEPT_RANGES, "bytes".to_owned()),
        (CACHE_CONTROL, "private, no-cache".to_owned()),
    ];
    let (status, part) = match selection {
        Selection::NotModified => {
            return Ok((StatusCode::NOT_MODIFIED, passed_over, common).into_response());
        }
        Selection::Whole => (StatusCode::OK, 0..len),
        Selection::Part(part) => (StatusCode::PARTIAL_CONTENT, part),
    };
    let described = [
        (CONTENT_TYPE, content_type(&file).to_owned()),
        (CONTENT_LENGTH, (part.end - part.start).to_string()),
    ];
    let place = (status == StatusCode::PARTIAL_CONTENT)
        .then(|| format!("bytes {}-{}/{len}", part.start, part.end - 1));
    let body = match method {
        Method::HEAD => Body::empty(),
        _ => Body::new(FileBody::new(opened, part)),
    };
    let place = place.map(|place| [(CONTENT_RANGE, place)]);
    Ok(match place {
        Some(place) => (status, passed_over, common, described, place, body).into_response(),
        None => (status, passed_over, common, described, body).into_response(),
    })
}

/// Opens a file of the checkpoint in `dir`, if its manifest lists it, and says if it is damaged.
/// Whatever a client writes for a file name, only listed names become paths.
fn open(dir: &Path, name: &str, checked: &Checked) -> Result<Option<Found>, CheckpointError> {
    if name == MANIFEST {
        let (file, bytes) = Manifest::open(dir)?;
        let blake3 = blake3::hash(&bytes).to_hex().to_string();
        return Ok(Some(Found { file, len: bytes.len() as u64, blake3 }));
    }
    let Some(listed) = Manifest::read(dir)?.files.remove(name) else { return Ok(None) };
    let file = checked.open(&dir.join(name), &listed)?;
    Ok(Some(Found { file, len: listed.len, blake3: listed.blake3 }))
}

fn content_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("json") => "application/json",
        Some("toml") => "application/toml",
        _ => "application/octet-stream",
    }
}
