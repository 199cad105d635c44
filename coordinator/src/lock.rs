//! One coordinator a run directory.

use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use proto::channel::Domain;
use rustix::fs::{FlockOperation, flock};
use serde::{Deserialize, Serialize};

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
        dir = path.parent().unwrap_or(path).display()
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
}

/// How long a lock is tried for. Who only looks, as [`RunLock::holder`] does, has it for a moment, and
/// then the text may name a coordinator that was killed; who has just taken it has not written yet.
const GLANCE: Duration = Duration::from_millis(100);

/// A held lock. The kernel lets go of it when the process ends, however it ends.
#[derive(Debug)]
pub struct RunLock {
    file: File,
    holder: Holder,
}

impl RunLock {
    /// Locks the file at `path` for this process and `domain`.
    pub fn acquire(path: &Path, domain: &Domain) -> Result<Self, LockError> {
        let io = |source: std::io::Error| LockError::Io { path: path.to_owned(), source };
        let mut file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(io)?;
        let patience = Instant::now() + GLANCE;
        while flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
            if Instant::now() > patience {
                let pid = read(&mut file).map(|holder| holder.pid);
                return Err(LockError::Held { path: path.to_owned(), pid });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let holder =
            Holder { pid: std::process::id(), domain: domain.as_str().to_owned(), http: None };
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
    pub fn holder(path: &Path) -> Option<Holder> {
        let mut file = File::open(path).ok()?;
        if flock(&file, FlockOperation::NonBlockingLockShared).is_ok() {
            return None;
        }
        read(&mut file)
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        let _ = self.file.set_len(0);
    }
}

fn read(file: &mut File) -> Option<Holder> {
    let mut text = String::new();
    file.rewind().ok()?;
    file.read_to_string(&mut text).ok()?;
    serde_json::from_str(&text).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_run_is_refused_while_the_first_lives() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("run.lock");
        let domain = Domain::fresh();
        let first = RunLock::acquire(&path, &domain).expect("free");
        let error = RunLock::acquire(&path, &Domain::fresh()).expect_err("held").to_string();
        assert!(error.contains(&std::process::id().to_string()), "{error}");
        assert_eq!(RunLock::holder(&path).expect("held").domain, domain.as_str());
        drop(first);
        assert_eq!(RunLock::holder(&path), None);
        RunLock::acquire(&path, &domain).expect("free again");
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
            RunLock::acquire(&path, &Domain::fresh()).expect("free in a moment");
        });
        let _long = look();
        let error = RunLock::acquire(&path, &Domain::fresh()).expect_err("held").to_string();
        assert!(!error.contains("process"), "{error}");
    }
}
