//! Every system call that changes a store, in one place, so that tests can cut each of them off.

use std::fs::{self, DirBuilder, File, Permissions};
use std::io::{self, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::Path;
use std::sync::Arc;

use super::error::CheckpointError;
use super::lock_timeout::LockTimeout;
use crate::files;

/// Bytes that one write takes.
pub(super) const CHUNK: usize = 64 << 10;

/// A step that is about to be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Step<'a> {
    /// `create`, `write`, `sync`, …
    pub(super) action: &'static str,
    /// What it is done to.
    pub(super) path: &'a Path,
}

/// Is asked before every step; an error takes the step's place.
pub(super) type Observer = Arc<dyn Fn(Step<'_>) -> io::Result<()> + Send + Sync>;

/// The file system as a store changes it.
#[derive(Clone, Default)]
pub(super) struct Disk {
    observer: Option<Observer>,
    /// How long the store's lock is waited for.
    pub(super) patience: LockTimeout,
}

impl std::fmt::Debug for Disk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { observer, patience } = self;
        f.debug_struct("Disk")
            .field("observed", &observer.is_some())
            .field("patience", patience)
            .finish()
    }
}

impl Disk {
    /// A disk whose every step `observer` sees first, and may refuse.
    #[cfg(test)]
    pub(super) fn observed(observer: Observer) -> Self {
        Self { observer: Some(observer), ..Self::default() }
    }

    /// Asks the observer, then takes the step.
    pub(super) fn step<T>(
        &self,
        action: &'static str,
        path: &Path,
        take: impl FnOnce() -> io::Result<T>,
    ) -> Result<T, CheckpointError> {
        let allowed = match &self.observer {
            Some(observer) => observer(Step { action, path }),
            None => Ok(()),
        };
        allowed.and_then(|()| take()).map_err(CheckpointError::io(path, action))
    }

    /// Makes a directory that nobody else may enter; its parent must exist.
    pub(super) fn create_dir(&self, path: &Path) -> Result<(), CheckpointError> {
        self.step("create", path, || DirBuilder::new().mode(0o700).create(path))
    }

    /// Lets those into a directory who may enter the one that it lies in.
    pub(super) fn open_dir(&self, path: &Path, above: &Path) -> Result<(), CheckpointError> {
        self.step("open", path, || {
            let (itself, above) = (fs::metadata(path)?.mode(), fs::metadata(above)?.mode());
            fs::set_permissions(path, Permissions::from_mode(itself & 0o7000 | above & 0o777))
        })
    }

    /// Opens a new file for writing.
    pub(super) fn create(&self, path: &Path) -> Result<File, CheckpointError> {
        self.step("create", path, || File::options().write(true).create_new(true).open(path))
    }

    /// Writes one chunk.
    pub(super) fn write(
        &self,
        file: &mut File,
        path: &Path,
        bytes: &[u8],
    ) -> Result<(), CheckpointError> {
        self.step("write", path, || file.write_all(bytes))
    }

    /// Writes a whole file and waits until it has reached the disk.
    pub(super) fn write_file(&self, path: &Path, bytes: &[u8]) -> Result<(), CheckpointError> {
        let mut file = self.create(path)?;
        for chunk in bytes.chunks(CHUNK) {
            self.write(&mut file, path, chunk)?;
        }
        self.sync(&file, path)
    }

    /// Waits until a file has reached the disk.
    pub(super) fn sync(&self, file: &File, path: &Path) -> Result<(), CheckpointError> {
        self.step("sync", path, || file.sync_all())
    }

    /// Waits until the names in a directory have reached the disk.
    pub(super) fn sync_dir(&self, path: &Path) -> Result<(), CheckpointError> {
        self.step("sync", path, || File::open(path)?.sync_all())
    }

    /// Gives a file or directory another name.
    pub(super) fn rename(&self, from: &Path, to: &Path) -> Result<(), CheckpointError> {
        self.step("rename", from, || fs::rename(from, to))
    }

    /// Removes a file.
    pub(super) fn remove_file(&self, path: &Path) -> Result<(), CheckpointError> {
        self.step("remove", path, || fs::remove_file(path))
    }

    /// Removes a directory with everything in it. What somebody else removes meanwhile is gone too.
    pub(super) fn remove_dir(&self, path: &Path) -> Result<(), CheckpointError> {
        let gone = |outcome: Result<(), CheckpointError>| match outcome {
            Err(error) if error.is_absence() => Ok(()),
            outcome => outcome,
        };
        let entries = match fs::read_dir(path).map_err(CheckpointError::io(path, "read")) {
            Err(error) if error.is_absence() => return Ok(()),
            entries => entries?,
        };
        for entry in entries {
            let entry = entry.map_err(CheckpointError::io(path, "read"))?;
            if entry.file_type().is_ok_and(|kind| !kind.is_dir()) {
                gone(self.remove_file(&entry.path()))?;
            }
        }
        gone(self.step("remove", path, || fs::remove_dir_all(path)))
    }

    /// Replaces a small file at once.
    pub(super) fn replace(&self, path: &Path, bytes: &[u8]) -> Result<(), CheckpointError> {
        self.step("write", path, || files::replace_io(path, bytes))
    }
}
