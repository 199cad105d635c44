//! Threads for what the simulator can do in independent parts.

use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};

use simulator::executor::Executor;

/// Runs tasks on this many threads, each taking the next task when it has done one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Threads(usize);

impl Threads {
    /// As many as there are processors for this process.
    pub fn available() -> Self {
        Self(std::thread::available_parallelism().map_or(1, NonZero::get))
    }

    /// This many, one at least.
    pub fn new(n: usize) -> Self {
        Self(n.max(1))
    }

    /// How many.
    pub fn count(&self) -> usize {
        self.0
    }
}

impl Executor for Threads {
    fn run(&self, n_tasks: usize, task: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        let work = || {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= n_tasks {
                    break;
                }
                task(index);
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..self.0.min(n_tasks) {
                scope.spawn(work);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_task_runs_once_whatever_the_number_of_threads() {
        for (threads, n_tasks) in [(1, 0), (0, 5), (3, 1), (3, 10)] {
            let calls: Vec<_> = (0..n_tasks).map(|_| AtomicUsize::new(0)).collect();
            Threads::new(threads).run(n_tasks, &|task| {
                calls[task].fetch_add(1, Ordering::Relaxed);
            });
            assert!(calls.iter().all(|calls| calls.load(Ordering::Relaxed) == 1), "{threads}");
        }
    }
}
