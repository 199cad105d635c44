//! Directories among the system's temporary files, for as long as a command works.
//!
//! They go away with whoever made them. Who is killed leaves theirs behind: so each is locked while it is used, and one that nobody
//! has locked is [left over](leftovers). The kernel gives a lock back however its process ends.

use std::fs::{self, File, Permissions};
use std::io;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use tempfile::TempDir;

use crate::owned_files::user;

/// What names of such directories begin with, and of no others.
const PREFIX: &str = "spaceoctopus-scratch-";

/// A directory that goes away with this value.
#[derive(Debug)]
pub struct Scratch {
    dir: TempDir,
    /// Locked, where the file system can do that.
    _lock: Option<File>,
}

impl Scratch {
    /// Makes one that nobody else reads, `purpose` in its name.
    ///
    /// # Errors
    /// Those of the system. Whoever reports one names [`place`].
    pub fn new(purpose: &str) -> io::Result<Self> {
        Self::new_in(&place(), purpose)
    }

    fn new_in(place: &Path, purpose: &str) -> io::Result<Self> {
        loop {
            let dir = tempfile::Builder::new()
                .prefix(&format!("{PREFIX}{purpose}-"))
                .permissions(Permissions::from_mode(0o700))
                .tempdir_in(place)?;
            match lock(dir.path()) {
                Ok(Found::Ours(lock)) => return Ok(Self { dir, _lock: Some(lock) }),
                // Somebody who cleans up was between its making and its locking.
                Ok(Found::InUse) => {}
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                // Nobody takes it for left over: the file system says that it is another user's, or knows no locks.
                Ok(Found::Others) => return Ok(Self { dir, _lock: None }),
                Err(error) if knows_no_locks(&error) => return Ok(Self { dir, _lock: None }),
                Err(error) => return Err(error),
            }
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.dir.path()
    }

    /// Removes it, and says if that fails.
    pub fn close(self) -> io::Result<()> {
        self.dir.close()
    }
}

/// Where such directories are made.
pub fn place() -> PathBuf {
    std::env::temp_dir()
}

/// A directory that whoever made it has left behind.
#[derive(Debug)]
pub struct Leftover {
    path: PathBuf,
    _lock: File,
}

impl Leftover {
    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes it.
    pub fn remove(self) -> io::Result<()> {
        fs::remove_dir_all(&self.path)
    }
}

/// Directories of this user that nobody has locked.
pub fn leftovers() -> io::Result<Vec<Leftover>> {
    leftovers_in(&place())
}

fn leftovers_in(place: &Path) -> io::Result<Vec<Leftover>> {
    let mut found = Vec::new();
    let entries = match fs::read_dir(place) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(found),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        if !entry.file_name().to_string_lossy().starts_with(PREFIX) {
            continue;
        }
        let path = entry.path();
        // One that cannot be opened is somebody else's, or has gone meanwhile.
        if let Ok(Found::Ours(lock)) = lock(&path) {
            found.push(Leftover { path, _lock: lock });
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

/// What a directory is found to be.
enum Found {
    /// This user's, and now locked.
    Ours(File),
    /// Locked by somebody else, or removed.
    InUse,
    /// Another user's.
    Others,
}

/// Whether a lock is refused because the file system has none.
fn knows_no_locks(error: &io::Error) -> bool {
    let errors = [Errno::BADF, Errno::NOLCK, Errno::NOTSUP, Errno::OPNOTSUPP, Errno::INVAL];
    Errno::from_io_error(error).is_some_and(|error| errors.contains(&error))
}

/// Locks this user's directory at `path`.
fn lock(path: &Path) -> io::Result<Found> {
    let flags = OFlags::DIRECTORY | OFlags::NOFOLLOW;
    let mut options = File::options();
    let dir = options.read(true).custom_flags(flags.bits().cast_signed()).open(path)?;
    let here = dir.metadata()?;
    if here.uid() != user() {
        return Ok(Found::Others);
    }
    match flock(&dir, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {}
        Err(Errno::WOULDBLOCK) => return Ok(Found::InUse),
        Err(error) => return Err(error.into()),
    }
    let is_there = fs::symlink_metadata(path)
        .is_ok_and(|there| (there.dev(), there.ino()) == (here.dev(), here.ino()));
    Ok(if is_there { Found::Ours(dir) } else { Found::InUse })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_used_is_private_and_no_leftover_and_what_a_killed_process_left_is() {
        let place = tempfile::tempdir().expect("tempdir");
        // Somebody's own, and what only looks like ours.
        for name in ["octopus-paper", PREFIX.trim_end_matches('-')] {
            fs::create_dir(place.path().join(name)).expect("made");
        }
        let elsewhere = tempfile::tempdir().expect("tempdir");
        std::os::unix::fs::symlink(elsewhere.path(), place.path().join(format!("{PREFIX}link")))
            .expect("linked");
        fs::write(place.path().join(format!("{PREFIX}file")), "").expect("written");

        let used = Scratch::new_in(place.path(), "test").expect("made");
        let mode = fs::metadata(used.path()).expect("there").permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        let killed = Scratch::new_in(place.path(), "test").expect("made");
        let left = killed.path().to_owned();
        fs::write(left.join("much"), "left").expect("written");
        assert!(leftovers_in(&place.path().join("none")).expect("nothing there").is_empty());
        let paths = || {
            let found = leftovers_in(place.path()).expect("searched");
            found.iter().map(|leftover| leftover.path().to_owned()).collect::<Vec<_>>()
        };
        assert!(paths().is_empty());
        // As the kernel does it.
        let Scratch { dir, _lock: lock } = killed;
        drop((dir.keep(), lock));
        // A program that another test starts has a copy of the lock for a moment.
        while paths().is_empty() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert_eq!(paths(), std::slice::from_ref(&left));
        let [found] =
            <[Leftover; 1]>::try_from(leftovers_in(place.path()).expect("searched")).expect("one");
        found.remove().expect("removed");
        assert!(!left.exists());
        let path = used.path().to_owned();
        assert!(path.exists());
        used.close().expect("removed");
        assert!(!path.exists());
    }
}
