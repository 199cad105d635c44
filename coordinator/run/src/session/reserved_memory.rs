//! A little shared memory that is kept for whoever takes a dead process's place.
//!
//! A successor takes the memory of who has died, but not at once: its connections are made while those
//! of the dead are still there. Where something else has filled shared memory meanwhile, those few pages
//! would be missing. So a file takes them when the run starts, and gives them back at a death.

use std::fs::File;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use channels::Domain;
use rustix::fs::{FallocateFlags, fallocate};

/// Size (bytes): generous for connections, which are queues of offsets.
const SIZE: u64 = 1 << 20;
/// How long a successor has to make its connections until the room is taken again.
const PAUSE: Duration = Duration::from_secs(10);

/// The room, while it is held.
#[derive(Debug)]
pub(super) struct ReservedMemory {
    path: PathBuf,
    released: Option<Instant>,
}

impl ReservedMemory {
    /// Takes it, in a domain whose directory is there.
    pub(super) fn take(domain: &Domain) -> Self {
        let headroom = Self { path: domain.root().join("headroom"), released: None };
        headroom.reserve();
        headroom
    }

    /// Without room there is none to be kept: that is no reason to end a run.
    fn reserve(&self) {
        let reserved = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .mode(0o600)
            .open(&self.path)
            .and_then(|file| Ok(fallocate(file, FallocateFlags::empty(), 0, SIZE)?));
        if let Err(error) = reserved {
            tracing::debug!(%error, "no shared memory is kept for successors");
        }
    }

    /// Gives it to those who come now.
    pub(super) fn release(&mut self) {
        let _ = std::fs::remove_file(&self.path);
        self.released = Some(Instant::now());
    }

    /// Takes it again once they have come.
    pub(super) fn keep(&mut self) {
        if self.released.is_some_and(|released| released.elapsed() >= PAUSE) {
            self.released = None;
            self.reserve();
        }
    }
}
