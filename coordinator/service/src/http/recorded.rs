//! What a run has recorded so far, for whoever draws it while it grows.

use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderName, HeaderValue, StatusCode, Uri};
use axum::response::{IntoResponse as _, Response};
use proto::run_dir::RunDir;
use store::regular_files;

use super::context::{Context, Shared, blocking};
use super::document::Bytes;
use super::problem::{ErrorBody, Problem};

/// Most that one answer holds (bytes).
const PIECE: u64 = 4 << 20;
/// Where this piece begins.
const BEGUN: HeaderName = HeaderName::from_static("octopus-from");
/// Where the next piece begins.
const NEXT: HeaderName = HeaderName::from_static("octopus-next");

/// Lines of the metrics, one an iteration. After a recovery lines are cut off: if `octopus-from` is not the `from` that was
/// asked for, what the client has is out of date, and these lines take its place.
#[utoipa::path(get, path = "/v1/metrics", tag = "run", operation_id = "recorded_metrics",
    params(("from" = Option<u64>, Query, description = "Where to begin (bytes): `octopus-next` of the answer before")),
    responses(
        (status = 200, description = "Whole lines, at most 4 MiB", body = inline(Bytes),
            content_type = "application/x-ndjson", headers(("octopus-from" = u64), ("octopus-next" = u64))),
        (status = 404, description = "The checkpoints are not those of a run", body = ErrorBody),
        (status = 422, description = "`from` is no number", body = ErrorBody),
    )
)]
pub(super) async fn metrics(State(context): State<Shared>, uri: Uri) -> Result<Response, Problem> {
    send(&context, &uri, RunDir::metrics_jsonl).await
}

/// Lines of the evaluations on held-out goals, likewise.
#[utoipa::path(get, path = "/v1/evaluations", tag = "run", operation_id = "recorded_evaluations",
    params(("from" = Option<u64>, Query, description = "Where to begin (bytes): `octopus-next` of the answer before")),
    responses(
        (status = 200, description = "Whole lines, at most 4 MiB", body = inline(Bytes),
            content_type = "application/x-ndjson", headers(("octopus-from" = u64), ("octopus-next" = u64))),
        (status = 404, description = "The checkpoints are not those of a run", body = ErrorBody),
        (status = 422, description = "`from` is no number", body = ErrorBody),
    )
)]
pub(super) async fn evaluations(
    State(context): State<Shared>,
    uri: Uri,
) -> Result<Response, Problem> {
    send(&context, &uri, RunDir::evaluations).await
}

async fn send(
    context: &Context,
    uri: &Uri,
    file: fn(&RunDir) -> PathBuf,
) -> Result<Response, Problem> {
    let from = place(uri.query(), "from")?;
    let run = run_of(context).ok_or_else(|| {
        let message =
            "the checkpoints here are not those of a run, so nothing is recorded beside them";
        Problem::new(StatusCode::NOT_FOUND, message)
    })?;
    let path = file(&run);
    let (begun, lines) =
        blocking(move || piece(&path, from)).await?.map_err(|error| Problem::internal(&error))?;
    let described = [
        (CONTENT_TYPE, HeaderValue::from_static("application/x-ndjson")),
        (BEGUN, HeaderValue::from(begun)),
        (NEXT, HeaderValue::from(begun + lines.len() as u64)),
    ];
    Ok((described, lines).into_response())
}

/// The run whose checkpoints are served.
pub(super) fn run_of(context: &Context) -> Option<RunDir> {
    let run = RunDir::new(context.store.root().parent()?);
    (run.checkpoints() == context.store.root() && run.config().is_file()).then_some(run)
}

/// The number of bytes that a query gives by a name; none is the beginning.
pub(super) fn place(query: Option<&str>, name: &str) -> Result<u64, Problem> {
    let mut pairs = query.into_iter().flat_map(|query| query.split('&'));
    let value = pairs.find_map(|pair| pair.strip_prefix(name)?.strip_prefix('='));
    value.map_or(Ok(0), |text| {
        text.parse().map_err(|_| {
            let message = format!("{name}={}: expected a number of bytes", text.escape_debug());
            Problem::new(StatusCode::UNPROCESSABLE_ENTITY, message)
        })
    })
}

/// Whole lines from a place on, and where they begin; from the beginning where the file has become shorter, or
/// is another one by now, so that no line begins there.
pub(super) fn piece(path: &Path, from: u64) -> std::io::Result<(u64, Vec<u8>)> {
    let mut file = match regular_files::open(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok((0, Vec::new())),
        other => other?,
    };
    let len = file.metadata()?.len();
    let mut from = if from > len { 0 } else { from };
    if from > 0 {
        let mut before = [0];
        file.seek(SeekFrom::Start(from - 1))?;
        file.read_exact(&mut before)?;
        if before != *b"\n" {
            from = 0;
        }
    }
    file.seek(SeekFrom::Start(from))?;
    let mut lines = Vec::new();
    file.take(PIECE).read_to_end(&mut lines)?;
    // The last line may still be being written.
    lines.truncate(lines.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1));
    Ok((from, lines))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_lines_are_sent_and_each_once() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("metrics.jsonl");
        assert_eq!(piece(&path, 7).expect("no file is no lines"), (0, Vec::new()));
        std::fs::write(&path, "{\"a\":1}\n{\"a\":2}\n{\"a\"").expect("writes");
        assert_eq!(piece(&path, 0).expect("reads"), (0, b"{\"a\":1}\n{\"a\":2}\n".to_vec()));
        assert_eq!(piece(&path, 8).expect("reads"), (8, b"{\"a\":2}\n".to_vec()));
        assert_eq!(piece(&path, 16).expect("reads"), (16, Vec::new()));
        // Cut off by a recovery: it begins anew, and the client hears of that.
        std::fs::write(&path, "{\"a\":1}\n").expect("writes");
        assert_eq!(piece(&path, 16).expect("reads"), (0, b"{\"a\":1}\n".to_vec()));
        // Cut off and grown again while nobody looked: no line begins there any more.
        std::fs::write(&path, "{\"a\":1}\n{\"a\":22}\n").expect("writes");
        let (begun, lines) = piece(&path, 16).expect("reads");
        assert_eq!((begun, lines.len()), (0, 17));
    }

    #[test]
    fn a_place_is_a_number_of_bytes() {
        assert_eq!(place(None, "from").expect("the beginning"), 0);
        assert_eq!(place(Some("x=1&from=12"), "from").expect("a number"), 12);
        assert!(place(Some("from=-1"), "from").expect_err("no place").message.contains("-1"));
    }
}
