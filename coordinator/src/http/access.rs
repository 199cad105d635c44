//! Who may ask for what.
//!
//! With a token, whoever shows it may do everything, and nobody else anything but ask whether the
//! service is alive. Without one the service listens on loopback only, where every program of this
//! machine may do everything, except that a web page in a browser of this machine may not: its
//! requests arrive from loopback too. Two things give them away. A page that reached the service
//! through a name of its own (DNS rebinding) sends that name as `Host`; a page that sends a request
//! elsewhere than to where it came from says where it came from in `Origin`.

use std::net::{IpAddr, SocketAddr};

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, HOST, ORIGIN, WWW_AUTHENTICATE};
use axum::http::{HeaderValue, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use proto::{ExitCode, ExitError};

use super::context::Shared;
use super::intake::Intake;
use super::problem::Problem;
use super::token::{TOKEN_VARIABLE, Token};

/// Path that needs no token, so that a load balancer can ask.
const PUBLIC: &str = "/health";

/// Refuses to listen beyond this machine without a token.
pub(super) fn check_address(address: SocketAddr, token: Option<&Token>) -> Result<(), ExitError> {
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
    match admit(context.token.as_ref(), &request) {
        Ok(()) => next.run(request).await,
        Err(problem) => {
            tracing::debug!(reason = problem.message, "request refused");
            Intake::new(request, 0, &context.limits).discard().await;
            problem.into_response()
        }
    }
}

fn admit(token: Option<&Token>, request: &Request) -> Result<(), Problem> {
    match token {
        Some(_) if request.uri().path() == PUBLIC => Ok(()),
        Some(token) => check_token(token, request),
        None => {
            let host = check_host(request)?;
            check_origin(request, host)
        }
    }
}

fn check_token(token: &Token, request: &Request) -> Result<(), Problem> {
    let offered = request.headers().get(AUTHORIZATION).map(HeaderValue::as_bytes);
    let bearer = offered.and_then(|value| {
        let (scheme, token) = value.split_at_checked("Bearer ".len())?;
        scheme.eq_ignore_ascii_case(b"Bearer ").then_some(token.trim_ascii())
    });
    let message = match bearer {
        Some(bearer) if token.matches(bearer) => return Ok(()),
        Some(_) => "the token is wrong",
        None => "a token is needed: send the header `Authorization: Bearer TOKEN`",
    };
    Err(Problem::new(StatusCode::UNAUTHORIZED, message)
        .with(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"spaceoctopus\"")))
}

/// Returns the host that the client believes to talk to, if that is this machine.
fn check_host(request: &Request) -> Result<&str, Problem> {
    let named = request.headers().get(HOST).and_then(|host| host.to_str().ok());
    // A request in absolute form names the host in its first line, which counts then.
    let host = request.uri().authority().map(axum::http::uri::Authority::as_str).or(named);
    match host {
        Some(host) if is_loopback(host) => Ok(host),
        _ => Err(Problem::new(
            StatusCode::FORBIDDEN,
            "the Host header must name this machine, localhost or 127.0.0.1: without a token the \
             service answers nobody who came by another name",
        )),
    }
}

fn check_origin(request: &Request, host: &str) -> Result<(), Problem> {
    if [Method::GET, Method::HEAD, Method::OPTIONS].contains(request.method()) {
        return Ok(());
    }
    let Some(origin) = request.headers().get(ORIGIN) else { return Ok(()) };
    let own = origin.to_str().is_ok_and(|origin| origin == format!("http://{host}"));
    if own {
        return Ok(());
    }
    Err(Problem::new(
        StatusCode::FORBIDDEN,
        "the Origin header names another web site: without a token the service changes nothing \
         at the request of a web page",
    ))
}

/// Whether `host`, with or without a port, is this machine itself.
fn is_loopback(host: &str) -> bool {
    let Ok(uri) = Uri::builder().scheme("http").authority(host).path_and_query("/").build() else {
        return false;
    };
    // `user@localhost` is no Host header.
    let Some(name) = uri.host().filter(|_| !host.contains('@')) else { return false };
    let address = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    address.map_or(name.eq_ignore_ascii_case("localhost"), |ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_this_machine() {
        for own in ["localhost", "LOCALHOST:80", "127.0.0.1:8270", "127.9.9.9", "[::1]:1", "[::1]"]
        {
            assert!(is_loopback(own), "{own}");
        }
        for foreign in [
            "",
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example:80",
            "10.0.0.1",
            "localhost@evil.example",
            "evil@localhost",
            "[::2]",
            "0.0.0.0",
            "a b",
        ] {
            assert!(!is_loopback(foreign), "{foreign}");
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
