//! What can go wrong.

/// Why something cannot be exported.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// An episode, for vectors or a recording, cannot be played.
    #[error("an episode cannot be played: {0}")]
    Episode(String),
    /// A recording cannot be put together.
    #[error("no recording: {0}")]
    Recording(String),
    /// More actors than a row number has room for.
    #[error("{0} actors are more than the 255 that the C code has room for")]
    Actors(usize),
}
