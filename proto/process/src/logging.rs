//! The logs of a child process, and what `RUST_LOG` asks of every program.

use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// What `RUST_LOG` says: a level, or levels of parts, as in `warn,run=debug`; none where it is not set or says neither.
pub fn filter() -> Option<Targets> {
    std::env::var("RUST_LOG").ok().filter(|text| !text.is_empty())?.parse().ok()
}

/// Sends the logs of this program to standard error, which the coordinator writes to a file:
/// without colours, what `RUST_LOG` says and from `info` on without it.
pub fn init() {
    let filter = filter().unwrap_or_else(|| Targets::new().with_default(LevelFilter::INFO));
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(false)
        .with_max_level(LevelFilter::TRACE)
        // It would be said on standard error, where a disk that is full makes a panic of it.
        .log_internal_errors(false)
        .finish()
        .with(filter)
        .init();
}
