//! How much clients may do at a time. All runs of a directory together have these bounds, as they have one pool of threads.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::limits::Limits;
use super::problem::Problem;

/// All bounds; a clone shares them.
#[derive(Debug, Clone)]
pub(super) struct Places {
    /// For changes of the store. Whoever has its lock makes changes wait, and each of them a thread; so there are few at a time,
    /// and reads always find one.
    pub(super) changes: Bound,
    /// For uploads.
    pub(super) uploads: Bound,
    /// For archives on their way out, and what reads as much.
    pub(super) archives: Bound,
    /// For pages that are told what happens.
    pub(super) watchers: Bound,
}

impl Places {
    pub(super) fn new(limits: &Limits) -> Self {
        Self {
            changes: Bound::new(
                limits.changes,
                "too many changes at once wait for the store; try again in a moment",
            ),
            uploads: Bound::new(limits.uploads, "too many uploads at once; try again in a moment"),
            archives: Bound::new(
                limits.archives,
                "too many archives are being downloaded; try again in a moment",
            ),
            watchers: Bound::new(
                limits.watchers,
                "too many pages look at once; close one, or try again in a moment",
            ),
        }
    }
}

/// So many of a kind at a time.
#[derive(Debug, Clone)]
pub(super) struct Bound {
    places: Arc<Semaphore>,
    /// What one more is told.
    refusal: &'static str,
}

impl Bound {
    fn new(n: usize, refusal: &'static str) -> Self {
        Self { places: Arc::new(Semaphore::new(n)), refusal }
    }

    /// A place, for as long as it is held; an answer where none is free.
    pub(super) fn take(&self) -> Result<OwnedSemaphorePermit, Problem> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        place.map_err(|_| Problem::busy(self.refusal))
    }
}
