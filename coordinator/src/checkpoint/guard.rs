//! Who may change a store: one at a time, whichever process or thread it is.
//!
//! The run, `octopus checkpoints` and the HTTP service may all change a store. That is the one exception to the
//! coordinator being the only writer, and it concerns nothing but checkpoints.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rustix::fs::{FlockOperation, flock};
use rustix::io::retry_on_intr;

use super::CheckpointError;
use super::disk::Disk;
use super::labels::Labels;
use super::opening::{Stamp, is_directory};

/// Name of the file that is locked.
const LOCK: &str = ".lock";
/// Prefix of a directory that is being written.
pub(super) const WRITING: &str = ".writing-";
/// Prefix of a directory that is being removed.
pub(super) const REMOVED: &str = ".removed-";
/// Prefix of a checkpoint that another one has replaced.
pub(super) const REPLACED: &str = ".replaced-";
/// How long such a one is kept.
const REPLACED_TIME: Duration = Duration::from_hours(7 * 24);
/// Prefix of labels that are being written.
const STUMP: &str = ".labels.json.";

/// The exclusive right to change a store. The kernel takes it back when the process ends.
///
/// It is held for renames and small files only: a checkpoint's bytes are written, synced and hashed
/// before it is taken, and removed after it is given back. So nobody waits for another one's
/// checkpoint, however large.
#[derive(Debug)]
pub(super) struct Guard {
    _file: File,
}

impl Guard {
    /// Waits for the right to change the store in `root`, which is made if it does not exist.
    pub(super) fn acquire(disk: &Disk, root: &Path) -> Result<Self, CheckpointError> {
        if !root.is_dir() {
            disk.step("create", root, || fs::create_dir_all(root))?;
            if let Some(parent) = root.parent().filter(|path| !path.as_os_str().is_empty()) {
                disk.sync_dir(parent)?;
            }
        }
        let path = root.join(LOCK);
        let file = disk.step("lock", &path, || {
            loop {
                let file = File::options().write(true).create(true).truncate(false).open(&path)?;
                retry_on_intr(|| flock(&file, FlockOperation::LockExclusive))?;
                if is_at(&file, &path) {
                    return Ok(file);
                }
            }
        })?;
        Ok(Self { _file: file })
    }

    /// Takes the right to change the store in `root` if it exists and nobody has it.
    pub(super) fn try_acquire(root: &Path) -> Option<Self> {
        let path = root.join(LOCK);
        let file = File::options().write(true).create(true).truncate(false).open(path).ok()?;
        flock(&file, FlockOperation::NonBlockingLockExclusive).ok()?;
        is_at(&file, &root.join(LOCK)).then_some(Self { _file: file })
    }

    /// Whether anybody has ever changed the store in `root`.
    pub(super) fn was_taken(root: &Path) -> bool {
        root.join(LOCK).exists()
    }
}

/// Whether `path` still names the open file: the lock of a store that was not to be is [removed](tidy).
fn is_at(file: &File, path: &Path) -> bool {
    let open = file.metadata().map(|there| Stamp::of(&there).identity());
    let there = path.metadata().map(|there| Stamp::of(&there).identity());
    matches!((open, there), (Ok(open), Ok(there)) if open == there)
}

/// Removes the lock from a store that holds nothing else, and then the directories in `made`, the
/// innermost first. Somebody who is about to use them finds them again or makes them anew.
fn tidy(disk: &Disk, root: &Path, made: &[PathBuf]) {
    let empty = || {
        let names = fs::read_dir(root).into_iter().flatten().flatten();
        names.map(|entry| entry.file_name()).all(|name| name == LOCK)
    };
    let lock = root.join(LOCK);
    if !empty() || !lock.exists() {
        return;
    }
    // Whoever holds it uses the store.
    let Some(_guard) = Guard::try_acquire(root) else { return };
    if empty() && disk.remove_file(&lock).is_ok() {
        for dir in made {
            if disk.step("remove", dir, || fs::remove_dir(dir)).is_err() {
                return;
            }
        }
    }
}

/// The directories that must be made for `path` to be one, the innermost first.
fn missing(path: &Path) -> Vec<PathBuf> {
    let named = path.ancestors().filter(|dir| !dir.as_os_str().is_empty());
    named.take_while(|dir| !dir.exists()).map(Path::to_owned).collect()
}

/// A directory that is being written, inside the store but invisible to readers.
///
/// While it lives it holds a lock on the directory itself. That is how [`sweep`] tells it from
/// what a killed process has left. Dropped, it is removed, unless it was published.
#[derive(Debug)]
pub(super) struct Scratch<'a> {
    disk: &'a Disk,
    root: PathBuf,
    path: PathBuf,
    /// What was made for it, and goes with it.
    made: Vec<PathBuf>,
    published: bool,
    _hold: File,
}

impl<'a> Scratch<'a> {
    /// Makes one.
    pub(super) fn new(disk: &'a Disk, root: &Path, label: &str) -> Result<Self, CheckpointError> {
        let made = missing(root);
        // Without the guard a sweep could come between making and locking it.
        let _guard = Guard::acquire(disk, root)?;
        let path = unique(root, WRITING, label);
        disk.create_dir(&path)?;
        let hold = disk.step("lock", &path, || {
            let hold = File::open(&path)?;
            flock(&hold, FlockOperation::NonBlockingLockExclusive)?;
            Ok(hold)
        });
        match hold {
            Ok(hold) => {
                let root = root.to_owned();
                Ok(Self { disk, root, path, made, published: false, _hold: hold })
            }
            Err(error) => {
                let _ = disk.remove_dir(&path);
                Err(error)
            }
        }
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it its final name.
    pub(super) fn publish(mut self, target: &Path, _: &Guard) -> Result<(), CheckpointError> {
        self.disk.rename(&self.path, target)?;
        self.published = true;
        Ok(())
    }

    /// Removes it.
    pub(super) fn discard(mut self) -> Result<(), CheckpointError> {
        self.published = true;
        self.disk.remove_dir(&self.path)
    }
}

impl Drop for Scratch<'_> {
    fn drop(&mut self) {
        if !self.published {
            // The error that led here is the one to report; a sweep takes what stays.
            let _ = self.disk.remove_dir(&self.path);
            tidy(self.disk, &self.root, &self.made);
        }
    }
}

/// Puts away what killed processes have left in the store and what has been replaced long ago;
/// returns the directories that are to be [removed](Disk::remove_dir) when the guard is given back.
pub(super) fn sweep(disk: &Disk, root: &Path, _: &Guard) -> Result<Vec<PathBuf>, CheckpointError> {
    let mut doomed = Vec::new();
    for entry in fs::read_dir(root).map_err(CheckpointError::io(root, "read"))? {
        let path = entry.map_err(CheckpointError::io(root, "read"))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !is_directory(&path) {
            continue;
        }
        if name.starts_with(REMOVED) {
            doomed.push(path);
        } else if name.starts_with(WRITING) || name.starts_with(REPLACED) {
            let stale = if name.starts_with(WRITING) { !is_held(&path) } else { is_stale(&path) };
            if stale {
                let away = unique(root, REMOVED, "stale");
                disk.rename(&path, &away)?;
                doomed.push(away);
            }
        } else if !name.starts_with('.') {
            sweep_labels(disk, &path)?;
        }
    }
    Ok(doomed)
}

/// Whether the writer of a scratch directory is alive.
fn is_held(path: &Path) -> bool {
    File::open(path).is_ok_and(|dir| flock(&dir, FlockOperation::NonBlockingLockExclusive).is_err())
}

/// Whether a replaced checkpoint was put aside long ago, and nobody had said to keep it.
fn is_stale(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let made = name.rsplit_once('-').and_then(|(_, nanos)| u128::from_str_radix(nanos, 16).ok());
    let age = made.and_then(|made| since_1970().as_nanos().checked_sub(made));
    let labels = Labels::read(path);
    age.is_some_and(|age| age > REPLACED_TIME.as_nanos())
        && !(labels.pinned || labels.milestone || !labels.tags.is_empty())
}

/// Removes the stump of labels whose writer was killed; the guard keeps living ones away.
fn sweep_labels(disk: &Disk, dir: &Path) -> Result<(), CheckpointError> {
    let Ok(entries) = fs::read_dir(dir) else { return Ok(()) };
    for entry in entries.flatten() {
        // As `files::temporary` calls them; a checkpoint has no other hidden file.
        if entry.file_name().to_string_lossy().starts_with(STUMP) {
            disk.remove_file(&entry.path())?;
        }
    }
    Ok(())
}

/// A path in `root` that nobody else uses: prefix, label, process, moment.
pub(super) fn unique(root: &Path, prefix: &str, label: &str) -> PathBuf {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let counter = COUNTER.fetch_add(1, Ordering::Relaxed);
    let nanos = since_1970().as_nanos();
    root.join(format!("{prefix}{label}-{}-{counter}-{nanos:x}", std::process::id()))
}

fn since_1970() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}
