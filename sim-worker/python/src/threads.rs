//! Threads for one call, of which the caller's looks for signals.

use std::num::NonZero;
use std::panic::resume_unwind;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::Builder;

use pyo3::{PyErr, PyResult};
use simulator::executor::Executor;

use crate::signals::Looks;

/// How many processors this process may use.
pub(crate) fn available() -> usize {
    std::thread::available_parallelism().map_or(1, NonZero::get)
}

/// Threads for one call, the caller's among them. To be made without the interpreter's lock held.
pub(crate) struct Threads {
    n: usize,
    stop: AtomicBool,
    /// What a signal handler of Python raised.
    raised: Mutex<Option<PyErr>>,
}

impl Threads {
    /// This many, or fewer where the system has no more.
    pub(crate) fn new(n: usize) -> Self {
        Self { n, stop: AtomicBool::new(false), raised: Mutex::new(None) }
    }

    /// What a signal handler raised meanwhile: the work was left in its middle then, and is of no use.
    pub(crate) fn interrupted(self) -> PyResult<()> {
        let raised = self.raised.into_inner().expect("no thread panics while it holds the lock");
        raised.map_or(Ok(()), Err)
    }
}

impl Executor for Threads {
    fn run(&self, n_tasks: usize, task: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        let work = |after: &mut dyn FnMut()| {
            while !self.stop.load(Ordering::Relaxed) {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= n_tasks {
                    break;
                }
                task(index);
                after();
            }
        };
        let mut looks = Looks::begin();
        let mut look = || {
            if let Err(error) = looks.look() {
                *self.raised.lock().expect("no thread panics while it holds the lock") =
                    Some(error);
                self.stop.store(true, Ordering::Relaxed);
            }
        };
        std::thread::scope(|scope| {
            // Where the system gives no more threads, those that there are do all tasks.
            let other = || Builder::new().spawn_scoped(scope, || work(&mut || {})).ok();
            let others: Vec<_> = (1..self.n.min(n_tasks)).map_while(|_| other()).collect();
            work(&mut look);
            for other in others {
                if let Err(panic) = other.join() {
                    resume_unwind(panic);
                }
            }
        });
    }
}
