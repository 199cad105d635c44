//! The page's files, as browsers ask for them.
//!
//! A browser that opens an address cannot show a token, so these need none; they are the same for every run
//! and say nothing of it. What they may do in the browser is as little as they need.

use axum::extract::Request;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, REFERRER_POLICY,
    VARY,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};

use super::document::Bytes;
use super::params::Params;
use super::problem::{ErrorBody, Problem};
use super::ranges;
use crate::page;

/// Scripts, styles and requests of this service only; WebAssembly may be compiled. Nothing is embedded, here or
/// elsewhere, and no form leads away.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; \
                      img-src 'self' data: blob:; connect-src 'self'; worker-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The page, for people. Needs no token, but asks its user for one.
#[utoipa::path(get, path = "/", tag = "service", security(()), responses(
    (status = 200, description = "The page", body = String, content_type = "text/html"),
    (status = 304, description = "The client has it"),
    (status = 404, description = "The page has not been built", body = ErrorBody),
))]
pub(super) async fn home(headers: HeaderMap) -> Result<Response, Problem> {
    at("/", &headers)
}

/// A file of the page. Needs no token.
#[utoipa::path(get, path = "/page/{file}", tag = "service", security(()), operation_id = "page_file",
    params(("file" = String, Path, description = "Name of the file")),
    responses(
        (status = 200, description = "The file, compressed by gzip", body = inline(Bytes),
            content_type = "application/octet-stream", headers(("etag" = String))),
        (status = 304, description = "The client has it"),
        (status = 404, description = "No such file", body = ErrorBody),
    )
)]
pub(super) async fn file(
    Params(name): Params<String>,
    request: Request,
) -> Result<Response, Problem> {
    let asset = page::asset(&name).ok_or_else(|| {
        Problem::new(StatusCode::NOT_FOUND, "the page has no such file; it begins at `/`")
    })?;
    Ok(send(asset, request.headers()))
}

/// What is at a path of the page.
pub(super) fn at(path: &str, headers: &HeaderMap) -> Result<Response, Problem> {
    let name = path.strip_prefix("/page/").unwrap_or("index.html");
    let asset =
        page::asset(name).ok_or_else(|| Problem::new(StatusCode::NOT_FOUND, page::MISSING))?;
    Ok(send(asset, headers))
}

/// The answer to a HEAD is the same: the router takes the content out of it, and says how long it is.
fn send(asset: &'static page::Asset, headers: &HeaderMap) -> Response {
    // Another program may listen at this address next time, so a browser asks each time.
    let common = [
        (ETAG, HeaderValue::from_static(&asset.etag)),
        (CACHE_CONTROL, HeaderValue::from_static("no-cache")),
        (VARY, HeaderValue::from_static("accept-encoding")),
        (CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY)),
        (REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    ];
    if ranges::is_known(headers, &asset.etag) {
        return (StatusCode::NOT_MODIFIED, common).into_response();
    }
    let described = [
        (CONTENT_TYPE, HeaderValue::from_static(asset.kind)),
        (CONTENT_ENCODING, HeaderValue::from_static("gzip")),
    ];
    (common, described, &asset.gzip[..]).into_response()
}
