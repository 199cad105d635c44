//! Opening what lies in a store. Nothing is followed out of it: a link in it is no checkpoint and no
//! file of one.

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

use super::CheckpointError;
use super::file_names::LABELS;
use crate::regular_files::{self, Links};
use crate::stamp::Stamp;

/// Whether `path` itself is a directory, and not a link to one.
pub(super) fn is_directory(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|there| there.is_dir())
}

/// Opens a file of a checkpoint for reading.
pub(super) fn file(path: &Path) -> Result<File, CheckpointError> {
    regular_files::open_with(path, File::options().read(true), Links::Refuse)
        .map_err(|error| refusal(path, error))
}

/// Reads a file of a checkpoint of `limit` bytes at most.
pub(super) fn bytes(path: &Path, limit: u64) -> Result<Vec<u8>, CheckpointError> {
    regular_files::drain(file(path)?, limit).map_err(|error| refusal(path, error))
}

/// What is no regular file, or too long, is damage; that it cannot be read is none.
fn refusal(path: &Path, error: std::io::Error) -> CheckpointError {
    match error.kind() {
        ErrorKind::InvalidInput | ErrorKind::FileTooLarge => {
            CheckpointError::damaged(path, error.to_string())
        }
        _ => CheckpointError::io(path, "read")(error),
    }
}

/// Reads a text of a checkpoint of `limit` bytes at most.
pub(super) fn text(path: &Path, limit: u64) -> Result<String, CheckpointError> {
    String::from_utf8(bytes(path, limit)?).map_err(|_| CheckpointError::damaged(path, "not UTF-8"))
}

impl Stamp {
    /// The stamps of everything in a directory but what users say about it; of what is no directory,
    /// its own.
    pub(super) fn of_dir(path: &Path) -> Vec<(std::ffi::OsString, Self)> {
        let Ok(itself) = path.symlink_metadata() else { return Vec::new() };
        if !itself.is_dir() {
            return vec![(std::ffi::OsString::new(), Self::of(&itself))];
        }
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let mut stamps: Vec<_> = entries
            .filter(|entry| !entry.file_name().to_string_lossy().contains(LABELS))
            .filter_map(|entry| Some((entry.file_name(), Self::of(&entry.metadata().ok()?))))
            .collect();
        stamps.sort();
        // Another directory of the same files, which may be none.
        stamps.push((std::ffi::OsString::new(), Self::of_place(&itself)));
        stamps
    }
}
