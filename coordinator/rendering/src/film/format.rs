//! What a film is written as, and why it cannot be.

use std::fmt;

use thiserror::Error;

/// What a film is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// 255 colours for the whole film; every program shows it.
    Gif,
    /// Every colour, packed without loss.
    Apng,
    /// Every colour, packed better without loss.
    WebP,
}

/// Why a film cannot be made.
#[derive(Debug, Error)]
#[error("the film cannot be written as {format}: {reason}")]
pub struct FilmError {
    format: &'static str,
    reason: String,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Gif, Self::Apng, Self::WebP];

    /// That of a file with this ending.
    pub fn of_extension(extension: &str) -> Option<Self> {
        match extension.to_ascii_lowercase().as_str() {
            "gif" => Some(Self::Gif),
            "png" | "apng" => Some(Self::Apng),
            "webp" => Some(Self::WebP),
            _ => None,
        }
    }

    /// What it is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gif => "GIF",
            Self::Apng => "APNG",
            Self::WebP => "WebP",
        }
    }

    /// What its files begin with.
    pub fn mark(self) -> &'static [u8] {
        match self {
            Self::Gif => b"GIF89a",
            Self::Apng => b"\x89PNG\r\n\x1a\n",
            Self::WebP => b"RIFF",
        }
    }

    pub(super) fn error(self, reason: &dyn fmt::Display) -> FilmError {
        FilmError { format: self.name(), reason: reason.to_string() }
    }
}
