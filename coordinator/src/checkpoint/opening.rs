//! Opening what lies in a store. Nothing is followed out of it: a link in it is no checkpoint and no
//! file of one.

use std::fs::{File, Metadata};
use std::io::Read as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;

use rustix::fs::OFlags;

use super::{CheckpointError, LABELS};

/// Whether `path` itself is a directory, and not a link to one.
pub(super) fn is_directory(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|there| there.is_dir())
}

/// Opens a file of a checkpoint for reading.
pub(super) fn file(path: &Path) -> Result<File, CheckpointError> {
    // Without waiting, or a named pipe in the place of a file would stop us for ever.
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let opened = File::options().read(true).custom_flags(flags.bits().cast_signed()).open(path);
    let file = opened.map_err(|error| match error.raw_os_error() {
        Some(code) if code == rustix::io::Errno::LOOP.raw_os_error() => {
            CheckpointError::damaged(path, "is a link; a checkpoint's files are its own")
        }
        _ => CheckpointError::io(path, "read")(error),
    })?;
    let metadata = file.metadata().map_err(CheckpointError::io(path, "read"))?;
    if !metadata.is_file() {
        return Err(CheckpointError::damaged(path, "is no regular file"));
    }
    Ok(file)
}

/// Reads a file of a checkpoint of `limit` bytes at most.
pub(super) fn bytes(path: &Path, limit: u64) -> Result<Vec<u8>, CheckpointError> {
    let mut bytes = Vec::new();
    file(path)?
        .take(limit.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(CheckpointError::io(path, "read"))?;
    if bytes.len() as u64 > limit {
        return Err(CheckpointError::damaged(path, format!("longer than {limit} bytes")));
    }
    Ok(bytes)
}

/// Reads a text of a checkpoint of `limit` bytes at most.
pub(super) fn text(path: &Path, limit: u64) -> Result<String, CheckpointError> {
    String::from_utf8(bytes(path, limit)?).map_err(|_| CheckpointError::damaged(path, "not UTF-8"))
}

/// What changes when somebody writes to a file or puts another in its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Stamp {
    device: u64,
    inode: u64,
    len: u64,
    modified: (i64, i64),
    changed: (i64, i64),
}

impl Stamp {
    /// What makes it this file and no other.
    pub(super) fn identity(&self) -> (u64, u64) {
        (self.device, self.inode)
    }

    /// The stamp of one file.
    pub(super) fn of(there: &Metadata) -> Self {
        Self {
            device: there.dev(),
            inode: there.ino(),
            len: there.len(),
            modified: (there.mtime(), there.mtime_nsec()),
            changed: (there.ctime(), there.ctime_nsec()),
        }
    }

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
        let place = Self { len: 0, modified: (0, 0), changed: (0, 0), ..Self::of(&itself) };
        stamps.push((std::ffi::OsString::new(), place));
        stamps
    }
}
