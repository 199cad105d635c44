//! Who may ask for what.
//!
//! Whoever shows a token of the service may do everything, and nobody else anything but ask whether
//! it is alive, not even from this machine: every user of it reaches its loopback, and so does every
//! web page in a browser of it. A page has no token, whatever name it came by (DNS rebinding) and
//! whatever it sends elsewhere.

use std::net::SocketAddr;

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, CONNECTION, HOST, ORIGIN, WWW_AUTHENTICATE};
use axum::http::uri::Authority;
use axum::http::{HeaderValue, StatusCode, Version};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use proto::{ExitCode, ExitError};

use super::connection_slots::ConnectionSlot;
use super::context::{Context, Shared};
use super::problem::Problem;
use super::request_body::RequestBody;
use super::token::{TOKEN_VARIABLE, Token};
use crate::page;

/// Whether a path needs no token. What stands there tells strangers nothing and changes nothing: a sign
/// of life for load balancers, and the page, which asks its user for the token.
pub(super) fn is_public(path: &str) -> bool {
    // The page of one of several runs is the same.
    let of_a_run = path.strip_prefix("/runs/").and_then(|rest| Some(&rest[rest.find('/')?..]));
    path == "/health" || page::is_at(path) || of_a_run.is_some_and(page::is_at)
}

/// Refuses to listen beyond this machine unless somebody has chosen a token for that.
pub fn check_address(address: SocketAddr, token: Option<&Token>) -> Result<(), ExitError> {
    if token.is_some() || address.ip().is_loopback() {
        return Ok(());
    }
    Err(ExitError::new(
        ExitCode::Usage,
        format!(
            "{address}: others can reach this address, so a token is needed: give --token-file \
             FILE or set {TOKEN_VARIABLE}, or listen on 127.0.0.1"
        ),
    ))
}

/// The layer around every route.
pub(super) async fn layer(State(context): State<Shared>, request: Request, next: Next) -> Response {
    let admitted = check_host(&request).and_then(|()| {
        if is_public(request.uri().path()) {
            return Ok(());
        }
        check_origin(&request)?;
        check_token(&context, &request)?;
        if context.read_only && !request.method().is_safe() {
            let message = "this service changes nothing: it was started to be looked at only";
            return Err(Problem::new(StatusCode::FORBIDDEN, message));
        }
        if let Some(seat) = request.extensions().get::<ConnectionSlot>() {
            seat.prove();
        }
        Ok(())
    });
    match admitted {
        Ok(()) => next.run(request).await,
        Err(problem) => {
            tracing::debug!(reason = problem.message, "request refused");
            RequestBody::new(request, 0, &context.limits).discard().await;
            // Who may not ask does not keep his place, either.
            problem.with(CONNECTION, HeaderValue::from_static("close")).into_response()
        }
    }
}

fn check_token(context: &Context, request: &Request) -> Result<(), Problem> {
    let offered = request.headers().get(AUTHORIZATION).map(HeaderValue::as_bytes);
    let bearer = offered.and_then(|value| {
        let (scheme, token) = value.split_at_checked("Bearer ".len())?;
        scheme.eq_ignore_ascii_case(b"Bearer ").then_some(token.trim_ascii())
    });
    let message = match bearer {
        Some(bearer) if context.knows(bearer) => return Ok(()),
        Some(_) => "the token is wrong",
        None => "a token is needed: send the header `Authorization: Bearer TOKEN`",
    };
    Err(Problem::new(StatusCode::UNAUTHORIZED, message)
        .with(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"spaceoctopus\"")))
}

/// Refuses a request that does not name one host (RFC 9112, section 3.2): a proxy and this service
/// could each believe another one of two.
fn check_host(request: &Request) -> Result<(), Problem> {
    let mut hosts = request.headers().get_all(HOST).iter();
    let problem = match (hosts.next(), hosts.next()) {
        (_, Some(_)) => "the request has two Host headers, expected one",
        (None, None) if request.version() < Version::HTTP_11 => return Ok(()),
        (None, None) => "the request has no Host header, expected one",
        (Some(host), None) if is_host(host.as_bytes()) => return Ok(()),
        (Some(_), None) => "the Host header names no host, expected HOST or HOST:PORT",
    };
    Err(Problem::new(StatusCode::BAD_REQUEST, problem))
}

/// Refuses what another page has a browser ask, also if it has come by the token. Browsers say by themselves, and
/// let no page say otherwise, where a request comes from: in `Sec-Fetch-Site`, or, beyond loopback without TLS, in
/// `Origin`. Programs send neither.
fn check_origin(request: &Request) -> Result<(), Problem> {
    let headers = request.headers();
    let own = match (headers.get("sec-fetch-site"), headers.get(ORIGIN)) {
        (Some(site), _) => site == "same-origin" || site == "none",
        (None, Some(origin)) => {
            let host = headers.get(HOST).map(HeaderValue::as_bytes);
            let origin = origin.as_bytes();
            let named =
                origin.strip_prefix(b"http://").or_else(|| origin.strip_prefix(b"https://"));
            named.is_some() && named == host
        }
        (None, None) => true,
    };
    if own {
        return Ok(());
    }
    let message =
        "the request comes from a page of another origin; only the service's own page may ask";
    Err(Problem::new(StatusCode::FORBIDDEN, message))
}

/// `user@host` is none.
fn is_host(text: &[u8]) -> bool {
    !text.contains(&b'@') && Authority::try_from(text).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_with_and_without_ports() {
        for host in ["localhost", "127.0.0.1:8270", "[::1]:80", "lab.example"] {
            assert!(is_host(host.as_bytes()), "{host}");
        }
        for wrong in ["", "a b", "user@localhost", "a/b", "[::1", "a\u{1b}"] {
            assert!(!is_host(wrong.as_bytes()), "{wrong:?}");
        }
    }

    #[test]
    fn beyond_loopback_only_with_a_token() {
        let address = |text: &str| text.parse::<SocketAddr>().expect("an address");
        let token = Token::parse("0123456789abcdef", "test").expect("long enough");
        for text in ["127.0.0.1:0", "[::1]:80"] {
            check_address(address(text), None).expect("loopback");
        }
        for text in ["0.0.0.0:0", "[::]:80", "192.168.1.2:80"] {
            let error = check_address(address(text), None).expect_err("not loopback");
            assert_eq!(error.code, ExitCode::Usage);
            assert!(error.message.contains("--token-file"), "{error}");
            check_address(address(text), Some(&token)).expect("with a token");
        }
    }
}
