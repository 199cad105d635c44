//! The logs of a child process.

use tracing_subscriber::EnvFilter;

/// Sends the logs of this program to standard error, which the coordinator writes to a file:
/// without colours, what `RUST_LOG` says and from `info` on without it.
pub fn init() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(false)
        .with_env_filter(filter)
        // It would be said on standard error, where a disk that is full makes a panic of it.
        .log_internal_errors(false)
        .init();
}
