//! One coordinator a run directory.

use std::fs::File;
use std::io::{ErrorKind, Seek, Write};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use serde::{Deserialize, Serialize};

use crate::owned_files::{self, Others};
use crate::regular_files::{self, Links};

/// What the lock file says about the run that holds it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Process id of the coordinator.
    pub pid: u32,
    /// Name of its shared-memory domain.
    pub domain: String,
    /// Where its HTTP service listens, `127.0.0.1:43210`, once it does.
    #[serde(default)]
    pub http: Option<String>,
}

/// Why a run directory cannot be locked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LockError {
    /// Another coordinator runs there.
    #[error(
        "{path}: a run is going on in this directory{who}; stop it first; \
         `octopus status {dir}` shows how it is doing",
        path = path.display(),
        who = pid.map_or_else(String::new, |pid| format!(" (process {pid})")),
        dir = output::quoted(path.parent().unwrap_or(path))
    )]
    Held {
        /// The lock file.
        path: PathBuf,
        /// The other coordinator's process, if it has said which it is.
        pid: Option<u32>,
    },
    /// The lock file cannot be written.
    #[error("{path}: cannot be locked: {source}", path = path.display())]
    Io {
        /// The lock file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The lock file is there but cannot be read.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Unreadable {
        /// The lock file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Others may have written the lock file.
    #[error(
        "{path}: is not believed: {source}; a run of yours that starts or is resumed here puts it right",
        path = path.display()
    )]
    Foreign {
        /// The lock file.
        path: PathBuf,
        /// Whose it is, or who may write it.
        source: std::io::Error,
    },
}

/// How long a lock is tried for. Who only looks, as [`RunLock::holder`] does, has it for a moment, and
/// then the text may name a coordinator that was killed; who has just taken it has not written yet.
const GLANCE: Duration = Duration::from_millis(100);
/// Longest lock file that is read (bytes).
const MAX_LEN: u64 = 64 << 10;

/// A held lock. The kernel lets go of it when the process ends, however it ends.
#[derive(Debug)]
pub struct RunLock {
    file: File,
    holder: Holder,
}

impl RunLock {
    /// Locks the file at `path` for this process and `domain`. Others may neither read it nor,
    /// which needs no more than to open it, lock it themselves.
    pub fn acquire(path: &Path, domain: &str) -> Result<Self, LockError> {
        let io = |source: std::io::Error| LockError::Io { path: path.to_owned(), source };
        let patience = Instant::now() + GLANCE;
        let file = loop {
            let mut file = regular_files::open_with(
                path,
                File::options()
                    .read(true)
                    .write(true)
                    .create(true)
                    .truncate(false)
                    .mode(owned_files::MODE),
                Links::Refuse,
            )
            .map_err(io)?;
            if !try_lock(&file, FlockOperation::NonBlockingLockExclusive).map_err(io)? {
                if Instant::now() > patience {
                    let pid = read(&mut file).map(|holder| holder.pid);
                    return Err(LockError::Held { path: path.to_owned(), pid });
                }
                std::thread::sleep(Duration::from_millis(5));
            } else if !regular_files::is_at(&file, path) {
                // Somebody has put another one there, or is about to.
            } else if owned_files::check(&file, Others::MayNothing).is_ok() {
                break file;
            } else if file.metadata().is_ok_and(|there| there.uid() == owned_files::user()) {
                // Of a version that did not take care.
                let rights = std::fs::Permissions::from_mode(owned_files::MODE);
                file.set_permissions(rights).map_err(io)?;
            } else {
                // Nobody holds another user's file, so one of our own can take its place.
                std::fs::remove_file(path).map_err(io)?;
            }
        };
        let holder = Holder { pid: std::process::id(), domain: domain.to_owned(), http: None };
        let mut lock = Self { file, holder };
        lock.write().map_err(io)?;
        Ok(lock)
    }

    /// Says where the run's HTTP service listens.
    pub fn announce(&mut self, http: &str) -> std::io::Result<()> {
        self.holder.http = Some(http.to_owned());
        self.write()
    }

    /// One write of more than what was there: a reader finds the old text or the new.
    fn write(&mut self) -> std::io::Result<()> {
        let text = serde_json::to_vec(&self.holder).expect("plain fields");
        self.file.rewind()?;
        self.file.write_all(&text)?;
        self.file.set_len(text.len() as u64)
    }

    /// Who holds the lock at `path`, if anybody does.
    pub fn holder(path: &Path) -> Result<Option<Holder>, LockError> {
        Ok(look(path)?.and_then(|mut file| read(&mut file)))
    }

    /// Who holds the lock at `path`, if anybody does, and if only this user can have written it.
    pub fn own_holder(path: &Path) -> Result<Option<Holder>, LockError> {
        let Some(mut file) = look(path)? else { return Ok(None) };
        owned_files::check(&file, Others::MayRead)
            .map_err(|source| LockError::Foreign { path: path.to_owned(), source })?;
        Ok(read(&mut file))
    }
}

/// The lock file at `path` if it is held.
fn look(path: &Path) -> Result<Option<File>, LockError> {
    let unreadable = |source| LockError::Unreadable { path: path.to_owned(), source };
    match regular_files::open_with(path, File::options().read(true), Links::Refuse) {
        Ok(file) => {
            let free =
                try_lock(&file, FlockOperation::NonBlockingLockShared).map_err(unreadable)?;
            Ok((!free).then_some(file))
        }
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(source) => Err(unreadable(source)),
    }
}

/// Locks a file unless somebody has it; whether it did. A file system that knows no locks, or has no more, is
/// an error, and no run.
fn try_lock(file: &File, operation: FlockOperation) -> std::io::Result<bool> {
    is_taken(flock(file, operation))
}

/// Whether the kernel's answer says that the lock is ours now.
fn is_taken(answer: Result<(), Errno>) -> std::io::Result<bool> {
    match answer {
        Ok(()) => Ok(true),
        Err(Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        let _ = self.file.set_len(0);
    }
}

fn read(file: &mut File) -> Option<Holder> {
    file.rewind().ok()?;
    serde_json::from_slice(&regular_files::drain(file, MAX_LEN).ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_run_is_refused_while_the_first_lives() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("run.lock");
        let domain = "octopus-0-12345678";
        let first = RunLock::acquire(&path, domain).expect("free");
        let error = RunLock::acquire(&path, "octopus-0-9abcdef0").expect_err("held").to_string();
        assert!(error.contains(&std::process::id().to_string()), "{error}");
        let holder = RunLock::own_holder(&path).expect("readable").expect("held");
        assert_eq!(holder.domain, domain);
        drop(first);
        assert_eq!(RunLock::holder(&path).expect("readable"), None);
        RunLock::acquire(&path, domain).expect("free again");
    }

    #[test]
    fn who_only_looks_keeps_nobody_out() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("run.lock");
        let look = || {
            let file = File::options().create(true).append(true).open(&path).expect("writable");
            flock(&file, FlockOperation::NonBlockingLockShared).expect("free");
            file
        };
        let glance = look();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                std::thread::sleep(Duration::from_millis(20));
                drop(glance);
            });
            RunLock::acquire(&path, "octopus-0-9abcdef0").expect("free in a moment");
        });
        let _long = look();
        let error = RunLock::acquire(&path, "octopus-0-9abcdef0").expect_err("held").to_string();
        assert!(!error.contains("process"), "{error}");
    }
    /// A lock file that others can open can be locked by them, and then no run starts there.
    #[test]
    fn nobody_else_can_open_the_lock() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("run.lock");
        let mode = || path.metadata().expect("there").mode() & 0o777;
        drop(RunLock::acquire(&path, "octopus-0-9abcdef0").expect("free"));
        assert_eq!(mode(), 0o600);
        // Of an earlier version.
        let before = std::fs::Permissions::from_mode(0o666);
        std::fs::set_permissions(&path, before.clone()).expect("own");
        let lock = RunLock::acquire(&path, "octopus-0-9abcdef0").expect("free");
        assert_eq!(mode(), 0o600);
        std::fs::set_permissions(&path, before).expect("own");
        let error = RunLock::own_holder(&path).expect_err("anybody may write it").to_string();
        assert!(error.contains("run.lock") && error.contains("other users may write"), "{error}");
        drop(lock);
        if rustix::process::geteuid().is_root() {
            std::os::unix::fs::chown(&path, Some(65534), None).expect("root may");
            let _lock = RunLock::acquire(&path, "octopus-0-9abcdef0").expect("takes its place");
            RunLock::own_holder(&path).expect("own").expect("held");
            assert_eq!(mode(), 0o600);
        }
    }

    #[test]
    fn a_file_system_without_locks_is_no_run_that_goes_on() {
        assert_eq!(is_taken(Ok(())).ok(), Some(true));
        assert_eq!(is_taken(Err(Errno::WOULDBLOCK)).ok(), Some(false));
        for errno in [Errno::NOLCK, Errno::OPNOTSUPP, Errno::STALE] {
            assert_eq!(
                is_taken(Err(errno)).map_err(|error| error.kind()),
                Err(std::io::Error::from(errno).kind())
            );
        }
    }

    #[test]
    fn a_lock_that_is_no_file_is_said_and_not_waited_for() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("run.lock");
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.expect("starts").success());
        let held = RunLock::acquire(&path, "octopus-0-9abcdef0").expect_err("a pipe").to_string();
        let read = RunLock::holder(&path).expect_err("a pipe").to_string();
        for error in [held, read] {
            assert!(error.contains("run.lock") && error.contains("is a pipe"), "{error}");
        }
    }
}
