//! The logs of a child process, and what `RUST_LOG` asks of every program.

use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// What `RUST_LOG` says: a level, or levels of parts, as in `warn,run=debug`; none where it is not set or says neither.
pub fn filter() -> Option<Targets> {
    parsed(&std::env::var("RUST_LOG").ok()?)
}

/// Empty pieces say nothing; [`Targets`] would take one for a level.
fn parsed(text: &str) -> Option<Targets> {
    let pieces: Vec<&str> = text.split(',').map(str::trim).filter(|p| !p.is_empty()).collect();
    if pieces.is_empty() { None } else { pieces.join(",").parse().ok() }
}

/// Sends the logs of this program to standard error, which the coordinator writes to a file:
/// without colours, what `RUST_LOG` says and from `info` on without it.
pub fn init() {
    let filter = filter().unwrap_or_else(|| Targets::new().with_default(LevelFilter::INFO));
    let lines = fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(false)
        // It would be said on standard error, where a disk that is full makes a panic of it.
        .log_internal_errors(false);
    tracing_subscriber::registry().with(filter).with(lines).init();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_those_that_are_named() {
        let level = |text: &str| parsed(text).and_then(|filter| filter.default_level());
        assert_eq!(level("info"), Some(LevelFilter::INFO));
        assert_eq!(level("info,"), Some(LevelFilter::INFO));
        assert_eq!(level(" off "), Some(LevelFilter::OFF));
        assert_eq!(level("run=debug"), None);
        for text in ["", " ", ",", "run=loud"] {
            assert!(parsed(text).is_none(), "{text:?}");
        }
        let both = parsed("warn, run=debug").expect("levels");
        assert!(both.iter().any(|part| part == ("run", LevelFilter::DEBUG)));
    }
}
