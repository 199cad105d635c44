//! Threads that are kept from update to update, with their caches and libtorch's settings and helpers.

use rayon::{ThreadPool, ThreadPoolBuilder};

/// `count` threads called `name`, at least one, which sleep while nobody asks anything of them.
///
/// # Panics
/// If the system gives none.
pub(crate) fn kept_threads(name: &'static str, count: usize) -> ThreadPool {
    ThreadPoolBuilder::new()
        .num_threads(count.max(1))
        .thread_name(|_| name.to_owned())
        .build()
        .unwrap_or_else(|error| panic!("{count} threads for an update cannot be started: {error}"))
}
