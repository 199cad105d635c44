//! Who may change a store: one at a time, whichever process or thread it is.
//!
//! The run, `octopus checkpoints` and the HTTP service may all change a store. That is the one exception to the
//! coordinator being the only writer, and it concerns nothing but checkpoints.

use std::fs::{self, File, Permissions};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

use super::disk::Disk;
use super::error::CheckpointError;
use super::labels::Labels;
use super::opening::is_directory;
use crate::owned_files;
use crate::regular_files::{self, Links};

/// Name of the file that is locked.
const LOCK: &str = ".lock";
/// Between two looks at a lock that somebody holds.
const PAUSE: Duration = Duration::from_millis(10);
/// Prefix of a directory that is being written.
pub(super) const WRITING: &str = ".writing-";
/// Prefix of a directory that is being removed.
pub(super) const REMOVED: &str = ".removed-";
/// Prefix of a checkpoint that another one has replaced.
pub(super) const REPLACED: &str = ".replaced-";
/// How long such a one is kept.
const REPLACED_TIME: Duration = Duration::from_hours(7 * 24);
/// Prefix of an archive that is being taken in, for the moment in which it has a name.
pub const UPLOAD: &str = ".upload-";
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
    /// Waits for the right to change the store in `root`, which is made if it does not exist, as long
    /// as the disk's user has patience.
    pub(super) fn acquire(disk: &Disk, root: &Path) -> Result<Self, CheckpointError> {
        if !root.is_dir() {
            disk.step("create", root, || fs::create_dir_all(root))?;
            if let Some(parent) = root.parent().filter(|path| !path.as_os_str().is_empty()) {
                disk.sync_dir(parent)?;
            }
        }
        let path = root.join(LOCK);
        disk.step("lock", &path, || Ok(()))?;
        let begun = Instant::now();
        loop {
            let file = open(&path).map_err(CheckpointError::io(&path, "lock"))?;
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) if regular_files::is_at(&file, &path) => return Ok(Self { _file: file }),
                // The lock of a store that was not to be is removed; the next one is another file.
                Ok(()) => {}
                Err(Errno::WOULDBLOCK) => {
                    if disk.patience.is_over(begun) {
                        let (seconds, pid) = (begun.elapsed().as_secs_f64(), holder(&file));
                        return Err(CheckpointError::Locked { path, seconds, pid });
                    }
                    std::thread::sleep(PAUSE);
                }
                Err(error) => return Err(CheckpointError::io(&path, "lock")(error.into())),
            }
        }
    }

    /// Takes the right to change the store in `root` if it exists and nobody has it.
    pub(super) fn try_acquire(root: &Path) -> Option<Self> {
        let path = root.join(LOCK);
        let file = open(&path).ok()?;
        flock(&file, FlockOperation::NonBlockingLockExclusive).ok()?;
        regular_files::is_at(&file, &path).then_some(Self { _file: file })
    }

    /// Whether anybody has ever changed the store in `root`.
    pub(super) fn was_taken(root: &Path) -> bool {
        root.join(LOCK).exists()
    }
}

/// Opens the lock file, or makes it. Nobody else may open it: that is all that it takes to lock it.
fn open(path: &Path) -> std::io::Result<File> {
    let mut options = File::options();
    options.write(true).create(true).truncate(false).mode(owned_files::MODE);
    let file = regular_files::open_with(path, &mut options, Links::Refuse)?;
    let there = file.metadata()?;
    if there.mode() & 0o077 != 0 && there.uid() == owned_files::user() {
        file.set_permissions(Permissions::from_mode(owned_files::MODE))?;
    }
    Ok(file)
}

/// How often the kernel's table of locks is read: while it is, other locks come and go, and a line can be
/// left out.
const LOOKS: usize = 5;

/// The process that holds a lock on an open file, if the kernel tells.
fn holder(file: &File) -> Option<u32> {
    (0..LOOKS).find_map(|_| look_up_holder(file))
}

fn look_up_holder(file: &File) -> Option<u32> {
    let there = file.metadata().ok()?;
    let (device, inode) = (there.dev(), there.ino());
    let place =
        format!("{:02x}:{:02x}:{inode}", rustix::fs::major(device), rustix::fs::minor(device));
    // `1: FLOCK  ADVISORY  WRITE 4711 fe:00:123456 0 EOF`; who waits has an arrow before that.
    let table = fs::read_to_string("/proc/locks").ok()?;
    table.lines().find_map(|line| {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let held = words.get(1) == Some(&"FLOCK") && words.get(5) == Some(&place.as_str());
        if held { words.get(4)?.parse().ok() } else { None }
    })
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
/// what a killed process has left; so nobody else may open it, which is all that it takes to lock it. Dropped, it is removed, unless it was published.
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

    /// Gives it its final name, and lets those in who may enter the store.
    pub(super) fn publish(mut self, target: &Path, _: &Guard) -> Result<(), CheckpointError> {
        self.disk.open_dir(&self.path, &self.root)?;
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
            // It has no name any more before a byte is in it, unless its process was killed.
            if name.starts_with(UPLOAD) {
                disk.remove_file(&path)?;
            }
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
        // As `temporary::beside` calls them; a checkpoint has no other hidden file.
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
