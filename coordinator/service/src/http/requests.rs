//! Counts the service's own requests and says so in the log.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

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
    pub(super) fn observe(&mut self, time: Duration) {
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

    pub(super) fn board(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
