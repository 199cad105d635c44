//! The answer of a comparison, as an error.

/// Two things that were compared are not the same. No failure but the answer, which standard output
/// holds: the program ends with exit code 1 and says no more.
#[derive(Debug, thiserror::Error)]
#[error("not the same")]
pub struct NotTheSame;
