//! Signals, heeded during long work: Ctrl-C ends it.

use std::time::{Duration, Instant};

use pyo3::{PyResult, Python};

/// How often is looked for them: often for a person, seldom for the work.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The looks of the caller's thread. To be made without the interpreter's lock held.
pub(crate) struct Looks {
    last: Instant,
}

impl Looks {
    /// The first one is still to come.
    pub(crate) fn begin() -> Self {
        Self { last: Instant::now() }
    }

    /// Looks, if it is time to; the error is what a signal handler of Python raised.
    pub(crate) fn look(&mut self) -> PyResult<()> {
        if self.last.elapsed() < LOOK_EVERY {
            return Ok(());
        }
        self.last = Instant::now();
        #[expect(
            clippy::redundant_closure_for_method_calls,
            reason = "the method's own lifetime is not general enough"
        )]
        Python::attach(|py| py.check_signals())
    }
}
