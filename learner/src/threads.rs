//! Threads that are kept from update to update, with their caches and libtorch's settings and helpers.

use std::ops::Deref;
use std::thread::{Builder, JoinHandle};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Threads that sleep while nobody asks anything of them. Who drops them waits until they have ended: what libtorch keeps for a thread
/// goes with it, and must not go beside the end of the process.
#[derive(Debug)]
pub(crate) struct KeptThreads {
    /// None while it is dropped.
    pool: Option<ThreadPool>,
    handles: Vec<JoinHandle<()>>,
}

impl KeptThreads {
    /// `count` threads called `name`, at least one.
    ///
    /// # Panics
    /// If the system gives none.
    pub(crate) fn new(name: &str, count: usize) -> Self {
        let mut handles = Vec::new();
        let pool = ThreadPoolBuilder::new()
            .num_threads(count.max(1))
            .spawn_handler(|thread| {
                let builder = Builder::new().name(name.to_owned());
                handles.push(builder.spawn(|| thread.run())?);
                Ok(())
            })
            .build()
            .unwrap_or_else(|error| {
                panic!("{count} threads for an update cannot be started: {error}")
            });
        Self { pool: Some(pool), handles }
    }
}

impl Deref for KeptThreads {
    type Target = ThreadPool;

    fn deref(&self) -> &ThreadPool {
        self.pool.as_ref().expect("until it is dropped")
    }
}

impl Drop for KeptThreads {
    fn drop(&mut self) {
        // They end when there is no pool any more.
        self.pool = None;
        for handle in self.handles.drain(..) {
            // Panics of what they did have been told to who asked for it.
            let _ = handle.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn threads_are_the_same_for_all_that_is_asked_and_have_ended_when_they_are_dropped() {
        struct Ends(&'static AtomicUsize);
        impl Drop for Ends {
            fn drop(&mut self) {
                self.0.fetch_add(1, Ordering::SeqCst);
            }
        }
        static ENDED: AtomicUsize = AtomicUsize::new(0);
        thread_local!(static KEPT: Ends = const { Ends(&ENDED) });
        let threads = KeptThreads::new("test", 1);
        let asked = || {
            KEPT.with(|_| {});
            std::thread::current().id()
        };
        assert_eq!(threads.install(asked), threads.install(asked));
        assert_eq!(ENDED.load(Ordering::SeqCst), 0);
        drop(threads);
        assert_eq!(ENDED.load(Ordering::SeqCst), 1, "nobody waited");
    }
}
