//! Counts the service's own requests and says so in the log.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;

use super::context::Shared;

/// Upper bounds of the latency classes (s).
pub(super) const BOUNDS: [f64; 12] =
    [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0, 5.0, 30.0];

/// Latencies by class.
#[derive(Debug, Clone, Default)]
pub(super) struct Histogram {
    /// Observations up to each of [`BOUNDS`], and beyond the last.
    pub(super) classes: [u64; BOUNDS.len() + 1],
    /// Sum of all observations (s).
    pub(super) sum: f64,
}

impl Histogram {
    fn observe(&mut self, time: Duration) {
        let seconds = time.as_secs_f64();
        self.classes[BOUNDS.partition_point(|&bound| bound < seconds)] += 1;
        self.sum += seconds;
    }
}

/// What has been asked so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Counts {
    /// Requests by method, route and status.
    pub(super) requests: BTreeMap<(&'static str, String, u16), u64>,
    /// Time from a request's head to its answer's, by route.
    pub(super) latencies: BTreeMap<String, Histogram>,
}

/// The counters. Routes are those of the router, so a client cannot make them grow.
#[derive(Debug, Default)]
pub(super) struct Requests {
    counts: Mutex<Counts>,
    connections: Arc<AtomicU64>,
}

/// A connection that counts as open until this is dropped.
#[derive(Debug)]
pub(super) struct Open(Arc<AtomicU64>);

impl Drop for Open {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Requests {
    /// Counts a connection.
    pub(super) fn connection(&self) -> Open {
        self.connections.fetch_add(1, Ordering::Relaxed);
        Open(Arc::clone(&self.connections))
    }

    /// Open connections.
    pub(super) fn connections(&self) -> u64 {
        self.connections.load(Ordering::Relaxed)
    }

    /// What has been asked so far.
    pub(super) fn counts(&self) -> Counts {
        self.board().clone()
    }

    fn board(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

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
