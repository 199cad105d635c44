//! Errors of this crate and the exit codes that every program of a run shares.

use std::path::PathBuf;

use crate::bucket_address::{hidden, hidden_in_lines};

/// What can be wrong with a configuration. What could be a secret in an address is not shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A file cannot be read.
    #[error("{path}: cannot be read: {source}", path = hidden(&path.display().to_string()))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The text is no TOML.
    #[error(
        "{origin}: not valid TOML: {message}",
        origin = hidden(origin),
        message = hidden_in_lines(message)
    )]
    Syntax {
        /// The file, or the flag as it was written.
        origin: String,
        /// The parser's words, with line and column.
        message: String,
    },
    /// A flag that gives no key a value, or several keys.
    #[error("{origin}: {message}", origin = hidden(origin))]
    Assignment {
        /// The flag as it was written.
        origin: String,
        /// What was expected, and what to do.
        message: &'static str,
    },
    /// A key that does not exist.
    #[error(
        "{origin}: unknown key `{key}`{hint}",
        origin = hidden(origin),
        key = hidden(key)
    )]
    UnknownKey {
        /// The file, or the flag as it was written.
        origin: String,
        /// The dotted key.
        key: String,
        /// A near name or the list of the group's keys.
        hint: String,
    },
    /// A key that every configuration has.
    #[error(
        "{origin}: key `{key}` is missing",
        origin = hidden(origin),
        key = hidden(key)
    )]
    Missing {
        /// The file, or the flag as it was written.
        origin: String,
        /// The dotted key.
        key: String,
    },
    /// A value that the key cannot have.
    #[error(
        "{origin}: key `{key}` wants {expected}, got {found}",
        origin = hidden(origin),
        key = hidden(key),
        found = hidden(found)
    )]
    WrongType {
        /// The file, or the flag as it was written.
        origin: String,
        /// The dotted key.
        key: String,
        /// What the key can have.
        expected: String,
        /// What was written.
        found: String,
    },
    /// A value out of its range, or two that do not fit each other.
    #[error("key `{key}`: {problem}; {cure}", problem = hidden(problem))]
    Invalid {
        /// The dotted key.
        key: &'static str,
        /// What is wrong, with the numbers.
        problem: String,
        /// What to do about it.
        cure: String,
    },
}

/// A size for people.
pub fn mib(bytes: u64) -> String {
    let mib = bytes as f64 / f64::from(1 << 20);
    match mib {
        10_000.0.. => format!("{:.1} GiB", mib / 1024.0),
        10.0.. => format!("{mib:.0} MiB"),
        _ => format!("{mib:.1} MiB"),
    }
}

/// Exit codes of `octopus`, `learner` and `sim-worker`, documented in the guide, `failures.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum ExitCode {
    /// All went well.
    Success = 0,
    /// Something failed while running; the message says what.
    Failure = 1,
    /// The command line is wrong (clap's own code).
    Usage = 2,
    /// A configuration, robot, actions or other input file is wrong.
    BadInput = 3,
    /// The machine lacks something: shared memory, descriptors, libtorch, a device.
    Environment = 4,
    /// A run directory or checkpoint exists already, is in use, or is damaged.
    RunDirectory = 5,
    /// A child process failed for good.
    Child = 6,
    /// Stopped at once by a second signal.
    Interrupted = 130,
}

/// An error with the exit code that it ends the program with.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct ExitError {
    /// The code.
    pub code: ExitCode,
    /// One clear message.
    pub message: String,
}

impl ExitError {
    /// Couples `message` with `code`.
    pub fn new(code: ExitCode, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }
}
