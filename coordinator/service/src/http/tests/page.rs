//! The page's files, and a service that is only to be looked at.

use axum::http::StatusCode;

use super::Bench;
use crate::page;

const STRANGER: (&str, &str) = ("authorization", "");

/// A browser shows no token when it opens an address. What it gets says nothing of the run, and may do little.
#[tokio::test]
async fn the_page_needs_no_token_and_may_do_little() {
    let bench = Bench::new(&[1]);
    let answer = bench.send("GET /", &[STRANGER], "").await;
    if !page::is_built() {
        assert_eq!(answer.status, StatusCode::NOT_FOUND);
        assert!(answer.error().contains("make page"), "{answer:?}");
        return;
    }
    let names = page::assets().iter().map(|asset| format!("GET /page/{}", asset.name));
    for line in std::iter::once("GET /".to_owned()).chain(names) {
        let answer = bench.send(&line, &[STRANGER], "").await;
        assert_eq!(answer.status, StatusCode::OK, "{line}");
        assert_eq!(answer.header("content-encoding"), "gzip", "{line}");
        assert_eq!(answer.body[..2], [0x1f, 0x8b], "{line}: gzip's own mark");
        let policy = answer.header("content-security-policy");
        assert!(
            policy.starts_with("default-src 'none'; script-src 'self' 'wasm-unsafe-eval';"),
            "{policy}"
        );
        for forbidden in ["unsafe-inline", "'unsafe-eval'", "http", "*"] {
            assert!(!policy.contains(forbidden), "{policy}");
        }
        assert!(policy.contains("frame-ancestors 'none'"), "{policy}");
        assert_eq!(answer.header("x-content-type-options"), "nosniff");

        let head = bench.send(&line.replace("GET", "HEAD"), &[STRANGER], "").await;
        assert_eq!((head.status, head.body.len()), (StatusCode::OK, 0), "{line}");
        assert_eq!(head.header("content-length"), answer.body.len().to_string(), "{line}");

        let etag = answer.header("etag");
        for known in [etag, &format!("\"x\", W/{etag}"), "*"] {
            let answer = bench.send(&line, &[STRANGER, ("if-none-match", known)], "").await;
            assert_eq!((answer.status, answer.body.len()), (StatusCode::NOT_MODIFIED, 0), "{line}");
        }
    }
    for line in
        ["GET /page/", "GET /page/no.js", "GET /page/../v1/checkpoints", "POST /v1/checkpoints"]
    {
        let answer = bench.send(line, &[STRANGER], "").await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED, "{line}");
    }
}

#[tokio::test]
async fn a_service_for_looking_changes_nothing() {
    let bench = Bench::read_only(&[1, 2]);
    let health = bench.ask("GET /health").await.json();
    assert_eq!(health["read_only"], true);
    for line in [
        "DELETE /v1/checkpoints/iteration-00000001",
        "PUT /v1/checkpoints/iteration-00000001/pin",
        "PUT /v1/checkpoints/iteration-00000001/tags/t",
        "POST /v1/checkpoints",
        "PUT /v1/workers",
    ] {
        let answer = bench.ask(line).await;
        assert_eq!(answer.status, StatusCode::FORBIDDEN, "{line}");
        assert!(answer.error().contains("changes nothing"), "{line}");
    }
    assert_eq!(bench.ask("GET /v1/checkpoints").await.status, StatusCode::OK);
    assert_eq!(bench.inventory(), ["iteration-00000001", "iteration-00000002"]);
}
