//! Whether a file is still the one that was looked at before.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt as _;

/// What changes when somebody writes to a file or puts another in its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stamp {
    device: u64,
    inode: u64,
    len: u64,
    modified: (i64, i64),
    changed: (i64, i64),
}

impl Stamp {
    /// The stamp of one file.
    pub fn of(there: &Metadata) -> Self {
        Self {
            device: there.dev(),
            inode: there.ino(),
            len: there.len(),
            modified: (there.mtime(), there.mtime_nsec()),
            changed: (there.ctime(), there.ctime_nsec()),
        }
    }

    /// Of a directory, what does not change when something is put into it.
    pub(crate) fn of_place(there: &Metadata) -> Self {
        Self { len: 0, modified: (0, 0), changed: (0, 0), ..Self::of(there) }
    }

    /// Whether the same file can have got `later` by nothing but appending to it.
    pub(crate) fn may_have_grown_to(&self, later: &Self) -> bool {
        (self.device, self.inode) == (later.device, later.inode) && self.len < later.len
    }
}
