//! Who may ask for what.

use axum::http::StatusCode;

use super::{Bench, TOKEN};
use crate::http::limits::Limits;
use crate::http::token::Token;

fn guarded() -> Bench {
    Bench::with(&[1], None, Some(TOKEN), Limits::default())
}

#[tokio::test]
async fn with_a_token_everything_but_health_needs_it() {
    let bench = guarded();
    for line in [
        "GET /metrics",
        "GET /openapi.json",
        "GET /v1/checkpoints",
        "POST /v1/checkpoints",
        "GET /v1/checkpoints/latest",
        "GET /v1/checkpoints/latest/files/manifest.json",
        "GET /v1/checkpoints/latest/archive",
        "PUT /v1/checkpoints/new",
        "DELETE /v1/checkpoints/iteration-00000001",
        "PUT /v1/checkpoints/iteration-00000001/pin",
        "PUT /v1/checkpoints/iteration-00000001/tags/t",
        "GET /v1/status",
        "PUT /v1/workers",
        "GET /no/such/route",
        "PATCH /v1/workers",
        "GET //health",
        "GET /health/",
    ] {
        let answer = bench.ask(line).await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED, "{line}");
        assert!(answer.header("www-authenticate").starts_with("Bearer"), "{line}");
        assert!(answer.error().contains("Authorization: Bearer"), "{line}");
    }
    assert_eq!(bench.ask("GET /health").await.status, StatusCode::OK);
    assert_eq!(bench.inventory(), ["iteration-00000001"], "nothing was changed");
}

#[tokio::test]
async fn only_the_token_itself_is_the_token() {
    let bench = guarded();
    let status = async |value: &str| {
        let headers = [("authorization", value)];
        bench.send("GET /v1/checkpoints", &headers, "").await.status
    };
    for right in [format!("Bearer {TOKEN}"), format!("bearer {TOKEN}"), format!("BEARER  {TOKEN} ")]
    {
        assert_eq!(status(&right).await, StatusCode::OK, "{right}");
    }
    for wrong in [
        TOKEN.to_owned(),
        format!("Basic {TOKEN}"),
        "Bearer".to_owned(),
        "Bearer ".to_owned(),
        format!("Bearer {}", &TOKEN[1..]),
        format!("Bearer {TOKEN}x"),
        format!("Bearer {}", TOKEN.to_uppercase()),
        format!("Bearer {TOKEN},{TOKEN}"),
    ] {
        assert_eq!(status(&wrong).await, StatusCode::UNAUTHORIZED, "{wrong}");
    }
}

#[tokio::test]
async fn with_a_token_any_name_of_the_host_will_do() {
    let bearer = format!("Bearer {TOKEN}");
    let headers = [("authorization", bearer.as_str()), ("host", "lab.example:8270")];
    assert_eq!(guarded().send("GET /v1/checkpoints", &headers, "").await.status, StatusCode::OK);
}

#[tokio::test]
async fn a_rebound_name_is_refused_without_a_token() {
    let bench = Bench::new(&[1]);
    for (host, status) in [
        ("localhost:8270", StatusCode::OK),
        ("127.0.0.1", StatusCode::OK),
        ("[::1]:8270", StatusCode::OK),
        ("evil.example:8270", StatusCode::FORBIDDEN),
        ("127.0.0.1.evil.example", StatusCode::FORBIDDEN),
        ("", StatusCode::FORBIDDEN),
    ] {
        for line in ["GET /v1/checkpoints", "GET /health", "GET /metrics"] {
            let answer = bench.send(line, &[("host", host)], "").await;
            assert_eq!(answer.status, status, "{line} of {host:?}");
        }
    }
    // The first line's host counts before the header.
    let answer = bench.send("GET http://evil.example/v1/checkpoints", &[], "").await;
    assert_eq!(answer.status, StatusCode::FORBIDDEN);
    assert!(answer.error().contains("localhost"));
}

#[tokio::test]
async fn a_web_page_changes_nothing_without_a_token() {
    let bench = Bench::new(&[1]);
    for origin in ["http://evil.example", "null", "http://127.0.0.1:3000", "https://127.0.0.1:8270"]
    {
        for line in [
            "PUT /v1/checkpoints/iteration-00000001/pin",
            "DELETE /v1/checkpoints/iteration-00000001",
            "PUT /v1/checkpoints/new",
            "POST /v1/checkpoints",
            "PUT /v1/workers",
        ] {
            let answer = bench.send(line, &[("origin", origin)], "").await;
            assert_eq!(answer.status, StatusCode::FORBIDDEN, "{line} from {origin}");
            assert!(answer.error().contains("Origin"), "{line}");
        }
    }
    let own = [("origin", "http://127.0.0.1:8270")];
    let answer = bench.send("PUT /v1/checkpoints/iteration-00000001/pin", &own, "").await;
    assert_eq!(answer.status, StatusCode::OK, "its own page may");
    let answer = bench.send("GET /v1/checkpoints", &[("origin", "http://evil.example")], "").await;
    assert!(
        !answer.headers.contains_key("access-control-allow-origin"),
        "a browser keeps the answer from the page"
    );
}

#[test]
fn tokens_that_can_be_guessed_or_sent_by_no_header_are_refused() {
    for wrong in ["", "short", "fifteen-letters", "with spaces in the middle", "ümlaute-ümlaute-ü"]
    {
        let error = Token::parse(wrong, "token.txt").expect_err(wrong);
        assert!(error.message.contains("token.txt"), "{error}");
        assert!(wrong.is_empty() || !error.message.contains(wrong), "it stays secret: {error}");
    }
    let token = Token::parse(&format!("  {TOKEN}\n"), "token.txt").expect("valid");
    assert!(token.matches(TOKEN.as_bytes()));
    assert!(!format!("{token:?}").contains(TOKEN));
}
