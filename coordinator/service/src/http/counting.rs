//! The layer around every route that counts requests. Neither headers nor bodies reach the log.

use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;

use super::context::Shared;

/// The layer around every route. Neither headers nor bodies reach the log.
pub(super) async fn layer(State(context): State<Shared>, request: Request, next: Next) -> Response {
    let method = name(request.method());
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str);
    let route = route.to_owned();
    let path = request.uri().path().to_owned();
    let start = Instant::now();
    let response = next.run(request).await;
    let (time, status) = (start.elapsed(), response.status().as_u16());
    tracing::debug!(method, path, status, ms = time.as_secs_f64() * 1e3, "request");
    let mut board = context.requests.board();
    board.latencies.entry(route.clone()).or_default().observe(time);
    *board.requests.entry((method, route, status)).or_default() += 1;
    drop(board);
    response
}

/// A client may invent methods; those are one.
fn name(method: &Method) -> &'static str {
    match method.as_str() {
        "GET" => "GET",
        "HEAD" => "HEAD",
        "POST" => "POST",
        "PUT" => "PUT",
        "DELETE" => "DELETE",
        "OPTIONS" => "OPTIONS",
        _ => "other",
    }
}
