//! Uploads: new, known, conflicting, malformed, too large, too many, interrupted.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::StatusCode;
use http_body::Frame;
use store::checkpoint::Name;

use super::Bench;
use crate::http::limits::Limits;

async fn archive(bench: &Bench, iteration: u64) -> Bytes {
    let name = Name::of_iteration(iteration);
    let answer = bench.ask(&format!("GET /v1/checkpoints/{name}/archive")).await;
    assert_eq!(answer.status, StatusCode::OK, "{answer:?}");
    answer.body
}

#[tokio::test]
async fn an_archive_moves_from_one_store_to_another() {
    let (here, there) = (Bench::new(&[1, 2]), Bench::new(&[]));
    let (one, two) = (archive(&here, 1).await, archive(&here, 2).await);
    let put = async |body: &Bytes, name: &str| {
        there.send(&format!("PUT /v1/checkpoints/{name}"), &[], body.clone()).await
    };
    let answer = put(&one, "copy").await;
    assert_eq!(answer.status, StatusCode::CREATED, "{answer:?}");
    assert_eq!(answer.json()["name"], "copy");
    assert_eq!(put(&one, "copy").await.status, StatusCode::OK, "it is there already");
    let answer = put(&two, "copy").await;
    assert_eq!(answer.status, StatusCode::CONFLICT, "{answer:?}");
    assert!(answer.error().contains("another"), "{}", answer.error());
    assert_eq!(put(&two, "iteration-00000002").await.status, StatusCode::CREATED);
    let answer = put(&one, "iteration-00000003").await;
    assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{answer:?}");
    assert_eq!(there.inventory(), ["copy", "iteration-00000002"]);
    for (original, copy) in [(1, "copy"), (2, "iteration-00000002")] {
        let original = here.store.dir(&Name::of_iteration(original));
        let copy = there.store.dir(&copy.parse().expect("a name"));
        for file in ["state.safetensors", "policy.safetensors", "manifest.json", "config.toml"] {
            let read = |dir: &std::path::Path| std::fs::read(dir.join(file)).expect("readable");
            assert!(read(&original) == read(&copy), "{file}");
        }
    }
}

#[tokio::test]
async fn what_is_no_archive_of_a_checkpoint_leaves_nothing() {
    let bench = Bench::new(&[1]);
    let whole = archive(&bench, 1).await;
    let mut flipped = whole.to_vec();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    for (what, body) in [
        ("nothing", Bytes::new()),
        ("a text", Bytes::from_static(b"hello")),
        ("zeros", vec![0; 100_000].into()),
        ("half", whole.slice(..whole.len() / 2)),
        ("its first header", whole.slice(..512)),
        ("a flipped bit", flipped.into()),
    ] {
        let answer = bench.send("PUT /v1/checkpoints/new", &[], body).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{what}: {answer:?}");
        assert!(answer.error().contains("archive"), "{what}: {}", answer.error());
    }
    assert_eq!(bench.inventory(), ["iteration-00000001"]);
}

#[tokio::test]
async fn too_large_is_refused_announced_or_not() {
    let source = Bench::new(&[1]);
    let body = archive(&source, 1).await;
    let limits = Limits { upload_bytes: 100_000, ..Limits::default() };
    let bench = Bench::with(&[], None, limits);
    let length = body.len().to_string();
    for headers in [&[("content-length", length.as_str())][..], &[]] {
        let answer = bench.send("PUT /v1/checkpoints/new", headers, body.clone()).await;
        assert_eq!(answer.status, StatusCode::PAYLOAD_TOO_LARGE, "{headers:?}");
        assert!(answer.error().contains("100000 bytes"), "{}", answer.error());
    }
    assert_eq!(bench.inventory(), [""; 0]);
}

#[tokio::test]
async fn two_of_one_name_at_a_time_are_one_and_a_conflict() {
    let source = Bench::new(&[1, 2]);
    let (one, two) = (archive(&source, 1).await, archive(&source, 2).await);
    let bench = Bench::new(&[]);
    let put = async |body: &Bytes| {
        bench.send("PUT /v1/checkpoints/name", &[], body.clone()).await.status.as_u16()
    };
    let (a, b, c, d) = tokio::join!(put(&one), put(&two), put(&one), put(&two));
    let mut statuses = [a, b, c, d];
    statuses.sort_unstable();
    assert_eq!(statuses, [200, 201, 409, 409]);
    assert_eq!(bench.inventory(), ["name"]);
}

/// A client that sends a little and then nothing, or goes.
struct Unfinished {
    first: Option<Bytes>,
    gone: bool,
}

impl http_body::Body for Unfinished {
    type Data = Bytes;
    type Error = std::io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<std::io::Result<Frame<Bytes>>>> {
        match self.first.take() {
            Some(bytes) => Poll::Ready(Some(Ok(Frame::data(bytes)))),
            None if self.gone => Poll::Ready(Some(Err(std::io::ErrorKind::ConnectionReset.into()))),
            None => Poll::Pending,
        }
    }
}

#[tokio::test]
async fn a_client_that_stalls_or_goes_leaves_nothing() {
    let source = Bench::new(&[1]);
    let start = archive(&source, 1).await.slice(..10_000);
    let limits = Limits { pace_time: Duration::from_millis(20), ..Limits::default() };
    let bench = Bench::with(&[], None, limits);
    for (gone, status) in [(false, StatusCode::REQUEST_TIMEOUT), (true, StatusCode::BAD_REQUEST)] {
        let body = Body::new(Unfinished { first: Some(start.clone()), gone });
        let answer = bench.send("PUT /v1/checkpoints/new", &[], body).await;
        assert_eq!(answer.status, status, "{answer:?}");
        assert_eq!(bench.inventory(), [""; 0]);
    }
}

#[tokio::test]
async fn uploads_beyond_the_limit_are_told_to_wait() {
    let limits = Limits { uploads: 0, archives: 0, ..Limits::default() };
    let bench = Bench::with(&[1], None, limits);
    for line in ["PUT /v1/checkpoints/new", "GET /v1/checkpoints/latest/archive"] {
        let answer = bench.ask(line).await;
        assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE, "{line}");
        assert_eq!(answer.header("retry-after"), "1", "{line}");
        assert!(answer.error().contains("try again"), "{line}");
    }
}

#[tokio::test]
async fn words_that_always_mean_something_else_are_no_names() {
    let source = Bench::new(&[1]);
    let body = archive(&source, 1).await;
    let bench = Bench::new(&[]);
    for name in ["latest", "best"] {
        let answer = bench.send(&format!("PUT /v1/checkpoints/{name}"), &[], body.clone()).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{name}: {answer:?}");
    }
    assert_eq!(bench.inventory(), [""; 0]);
}

#[tokio::test]
async fn a_name_that_means_something_else_is_refused_before_the_body_is_read() {
    let bench = Bench::new(&[1]);
    bench.store.tag(&Name::of_iteration(1), "mine").expect("tags");
    for name in ["best", "latest", "promoted", "17", "catalogue.sqlite", "mine"] {
        let answer = bench.send(&format!("PUT /v1/checkpoints/{name}"), &[], "no archive").await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{name}: {answer:?}");
        assert!(answer.error().contains("choose another name"), "{}", answer.error());
    }
}

#[tokio::test]
async fn beside_a_live_run_an_upload_is_at_most_a_few_times_its_state() {
    let source = Bench::new(&[1, 2]);
    let (one, two) = (archive(&source, 1).await, archive(&source, 2).await);
    for (states, least, status) in [
        (4, 0, StatusCode::CREATED),
        (1, 0, StatusCode::PAYLOAD_TOO_LARGE),
        (0, 0, StatusCode::INSUFFICIENT_STORAGE),
        (0, 2 * two.len() as u64, StatusCode::CREATED),
    ] {
        let limits =
            Limits { live_upload_states: states, live_upload_bytes: least, ..Limits::default() };
        let live = Some(crate::live::LiveRun::new());
        let bench = Bench::with(&[1], live, limits.clone());
        // What others brought is no measure.
        let foreign = bench.store.import(&two[..], None);
        assert!(foreign.expect("imports").labels.imported);
        let answer = bench.send("PUT /v1/checkpoints/new", &[], one.clone()).await;
        assert_eq!(answer.status, status, "{states} {least}: {answer:?}");
        let alone = Bench::with(&[], None, limits);
        let answer = alone.send("PUT /v1/checkpoints/new", &[], one.clone()).await;
        assert_eq!(answer.status, StatusCode::CREATED, "alone: {answer:?}");
    }
}

#[tokio::test]
async fn uploads_leave_room_on_the_disk() {
    let source = Bench::new(&[1]);
    let body = archive(&source, 1).await;
    let length = body.len().to_string();
    let free = store::files::free_space(source.dir.path()).expect("a disk");
    for reserve in [u64::MAX, 2 * free] {
        let bench = Bench::with(&[], None, Limits { disk_reserve: reserve, ..Limits::default() });
        for headers in [&[("content-length", length.as_str())][..], &[]] {
            let answer = bench.send("PUT /v1/checkpoints/new", headers, body.clone()).await;
            assert_eq!(answer.status, StatusCode::INSUFFICIENT_STORAGE, "{headers:?}");
            let said = answer.error();
            assert!(said.contains(&reserve.to_string()) && said.contains("stay free"), "{said}");
        }
        assert_eq!(bench.inventory(), [""; 0]);
    }
}

#[tokio::test]
async fn beside_a_live_run_all_uploads_together_have_a_limit() {
    let source = Bench::new(&[1]);
    let body = archive(&source, 1).await;
    let limits =
        Limits { live_upload_bytes: 2 * body.len() as u64, live_uploads: 1, ..Limits::default() };
    let live = Some(crate::live::LiveRun::new());
    let bench = Bench::with(&[], live, limits);
    let mut statuses = Vec::new();
    for name in ["a", "b", "c", "d", "e"] {
        let answer = bench.send(&format!("PUT /v1/checkpoints/{name}"), &[], body.clone()).await;
        if !answer.status.is_success() {
            assert!(answer.error().contains("delete some"), "{}", answer.error());
        }
        statuses.push(answer.status.as_u16());
    }
    assert_eq!(statuses, [201, 201, 201, 507, 507], "an archive is larger than what is in it");
    assert_eq!(bench.inventory(), ["a", "b", "c"]);
    assert_eq!(bench.ask("DELETE /v1/checkpoints/a").await.status, StatusCode::NO_CONTENT);
    let answer = bench.send("PUT /v1/checkpoints/d", &[], body.clone()).await;
    assert_eq!(answer.status, StatusCode::CREATED);
}
