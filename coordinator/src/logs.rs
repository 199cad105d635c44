//! Logs: structured lines on standard error, chosen by `RUST_LOG`.

use std::io::IsTerminal as _;

use tracing_subscriber::EnvFilter;

use crate::report::progress::LogWriter;

/// Sends the logs of this program to standard error, around a progress bar if there is one.
pub fn init() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(|| LogWriter)
        .with_target(false)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
}
