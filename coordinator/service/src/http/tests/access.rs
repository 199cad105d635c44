//! Who may ask for what.

use axum::http::StatusCode;

use super::{Bench, OTHER_TOKEN, TOKEN};
use crate::http::token::Token;

#[tokio::test]
async fn everything_but_health_needs_a_token() {
    let bench = Bench::new(&[1]);
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
        let answer = bench.send(line, &[("authorization", "")], "").await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED, "{line}");
        assert!(answer.header("www-authenticate").starts_with("Bearer"), "{line}");
        assert_eq!(answer.header("connection"), "close", "{line}");
        assert!(answer.error().contains("Authorization: Bearer"), "{line}");
    }
    let answer = bench.send("GET /health", &[("authorization", "")], "").await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(bench.inventory(), ["iteration-00000001"], "nothing was changed");
}

#[tokio::test]
async fn only_the_token_itself_is_the_token() {
    let bench = Bench::new(&[1]);
    let status = async |value: &str| {
        let headers = [("authorization", value)];
        bench.send("GET /v1/checkpoints", &headers, "").await.status
    };
    for right in [format!("Bearer {TOKEN}"), format!("bearer {TOKEN}"), format!("BEARER  {TOKEN} ")]
        .into_iter()
        .chain([format!("Bearer {OTHER_TOKEN}")])
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
async fn any_name_of_the_host_will_do_but_only_one() {
    let bench = Bench::new(&[1]);
    for host in ["lab.example:8270", "127.0.0.1", "[::1]:8270"] {
        let answer = bench.send("GET /v1/checkpoints", &[("host", host)], "").await;
        assert_eq!(answer.status, StatusCode::OK, "{host}");
    }
    for hosts in [
        &[("host", "localhost"), ("host", "evil.example")][..],
        &[("host", "localhost"), ("host", "localhost")],
        &[("host", "")],
        &[("host", "user@localhost")],
        &[("host", "a b")],
    ] {
        for line in ["GET /v1/checkpoints", "GET /health", "PUT /v1/workers"] {
            let answer = bench.send(line, hosts, "").await;
            assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{line} of {hosts:?}");
            assert!(answer.error().contains("Host header"), "{line} of {hosts:?}");
        }
    }
}

/// A page reaches the service through the browser of its user, by whatever name, but has no token.
#[tokio::test]
async fn a_web_page_learns_and_changes_nothing() {
    let bench = Bench::new(&[1]);
    for (name, value) in [("origin", "http://evil.example"), ("host", "evil.example:8270")] {
        for line in [
            "GET /v1/checkpoints",
            "PUT /v1/checkpoints/iteration-00000001/pin",
            "DELETE /v1/checkpoints/iteration-00000001",
            "POST /v1/checkpoints",
        ] {
            let answer = bench.send(line, &[(name, value), ("authorization", "")], "").await;
            let refused = [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN];
            assert!(refused.contains(&answer.status), "{line} with {name} {value}");
            assert!(!answer.headers.contains_key("access-control-allow-origin"), "{line}");
        }
    }
    assert_eq!(bench.inventory(), ["iteration-00000001"]);
}

/// Also one that has come by the token: browsers say where a request is from.
#[tokio::test]
async fn a_page_of_another_origin_is_refused_whatever_it_shows() {
    let bench = Bench::new(&[1]);
    let own = ("origin", "http://127.0.0.1:8270");
    let forged = ("origin", "http://evil.example");
    for (headers, expected) in [
        (&[own][..], StatusCode::OK),
        (&[("origin", "https://127.0.0.1:8270")], StatusCode::OK),
        (&[("sec-fetch-site", "same-origin")], StatusCode::OK),
        // A proxy in front has another name than the page knows.
        (&[("sec-fetch-site", "same-origin"), ("origin", "https://lab.example")], StatusCode::OK),
        (&[("sec-fetch-site", "none")], StatusCode::OK),
        (&[forged], StatusCode::FORBIDDEN),
        (&[("origin", "null")], StatusCode::FORBIDDEN),
        (&[("origin", "http://127.0.0.1:8271")], StatusCode::FORBIDDEN),
        (&[own, ("sec-fetch-site", "same-site")], StatusCode::FORBIDDEN),
        (&[own, ("sec-fetch-site", "cross-site")], StatusCode::FORBIDDEN),
    ] {
        for line in ["GET /v1/checkpoints", "PUT /v1/checkpoints/iteration-00000001/pin"] {
            let answer = bench.send(line, headers, "").await;
            assert_eq!(answer.status, expected, "{line} with {headers:?}");
            assert!(!answer.headers.contains_key("access-control-allow-origin"), "{line}");
        }
    }
    let answer = bench.send("GET /health", &[forged], "").await;
    assert_eq!(answer.status, StatusCode::OK, "what strangers may know, pages may");
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
