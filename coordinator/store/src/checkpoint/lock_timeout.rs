//! How long somebody waits for the right to change a store.
//!
//! It is held for renames and small files only, so hardly anybody ever waits. But whoever may open
//! the lock can hold it for as long as he likes, and a disk may stand still: without an end, a run
//! could neither go on nor be stopped.

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// LockTimeout of who has not said how long he waits: a person before a command.
const DEFAULT: Duration = Duration::from_secs(10);

/// How long somebody waits.
#[derive(Clone)]
pub struct LockTimeout {
    time: Duration,
    stop: Option<Arc<dyn Fn() -> bool + Send + Sync>>,
}

impl LockTimeout {
    /// So long.
    pub fn new(time: Duration) -> Self {
        Self { time, stop: None }
    }

    /// But no longer once `stop` says so.
    #[must_use]
    pub fn unless(self, stop: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self { stop: Some(Arc::new(stop)), ..self }
    }

    /// Whether somebody who has waited since `begun` gives up.
    pub(super) fn is_over(&self, begun: Instant) -> bool {
        begun.elapsed() >= self.time || self.stop.as_ref().is_some_and(|stop| stop())
    }
}

impl Default for LockTimeout {
    fn default() -> Self {
        Self::new(DEFAULT)
    }
}

impl fmt::Debug for LockTimeout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time, stop } = self;
        f.debug_struct("LockTimeout")
            .field("time", time)
            .field("stoppable", &stop.is_some())
            .finish()
    }
}
