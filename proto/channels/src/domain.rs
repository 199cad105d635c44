//! The name under which a run's shared resources live.

use std::collections::BTreeSet;
use std::fs::{DirEntry, File};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, Path as IpcPath, SemanticString};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

use crate::error::ChannelError;
use crate::place::SHARED_MEMORY;
use crate::segment::MARGIN;

/// Mode of a directory that only its owner can look into.
const PRIVATE: u32 = 0o700;

/// The file that the coordinator holds locked as long as it lives.
const HELD: &str = "held";

/// How long that lock is tried for: nobody else keeps it, but who only looks, as [`Domain::is_held`] does, has it for a
/// moment.
const GLANCE: Duration = Duration::from_secs(1);

/// Names the directory in shared memory with all segments, sockets and files of one run.
///
/// It holds the user's id: another user's run is never touched.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain(String);

fn own_uid() -> u32 {
    rustix::process::getuid().as_raw()
}

/// Entries of shared memory whose names begin with `prefix` and that belong to this user.
fn own_entries(prefix: &str) -> std::io::Result<Vec<DirEntry>> {
    let mut own = Vec::new();
    for entry in std::fs::read_dir(SHARED_MEMORY)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(prefix)
            && entry.metadata().is_ok_and(|metadata| metadata.uid() == own_uid())
        {
            own.push(entry);
        }
    }
    Ok(own)
}

/// Prefix of every domain of the user with id `uid`.
fn user_prefix(uid: u32) -> String {
    format!("octopus-{uid}-")
}

impl Domain {
    /// A fresh name: user, process and time tell it from all others.
    pub fn fresh() -> Self {
        let since_epoch =
            std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let seed = format!("{}-{}", std::process::id(), since_epoch.as_nanos());
        let hash = blake3::hash(seed.as_bytes()).to_hex();
        Self(format!("{}{}", user_prefix(own_uid()), &hash[..8]))
    }

    /// Parses a name that [`Self::as_str`] gave; refuses what does not belong to this user.
    pub fn parse(name: &str) -> Result<Self, ChannelError> {
        let prefix = user_prefix(own_uid());
        let valid = name.strip_prefix(&prefix).is_some_and(|rest| {
            rest.len() == 8 && rest.bytes().all(|byte| byte.is_ascii_hexdigit())
        });
        if valid {
            return Ok(Self(name.to_owned()));
        }
        Err(ChannelError::Open {
            service: name.to_owned(),
            reason: format!("not a domain of this user: {prefix} and eight hexadecimal digits"),
            layout: proto::layout::layout_hash(),
        })
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The directory with everything that the run's processes share: segments, sockets, locks.
    pub fn root(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(&self.0)
    }

    /// Makes [`Self::root`], into which nobody else can look, so that what is made in it is private
    /// from the start.
    pub(crate) fn make_root(&self) -> Result<(), ChannelError> {
        match std::fs::DirBuilder::new().mode(PRIVATE).create(self.root()) {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => self.check_root(),
            Err(error) if error.kind() == ErrorKind::StorageFull => {
                let what = self.root().display().to_string();
                Err(ChannelError::Full { what, needed: MARGIN, free: 0 })
            }
            Err(error) => Err(self.refuse(error.to_string())),
        }
    }

    /// Refuses a directory in the place of [`Self::root`] that is not private.
    pub(crate) fn check_root(&self) -> Result<(), ChannelError> {
        let there = std::fs::symlink_metadata(self.root());
        let there = there.map_err(|error| self.refuse(error.to_string()))?;
        if there.is_dir() && there.uid() == own_uid() && there.mode() & 0o777 == PRIVATE {
            return Ok(());
        }
        Err(self.refuse(format!(
            "it should be a directory of this user with mode {PRIVATE:o}, and is {} of user {} with \
             mode {:o}; remove it",
            if there.is_dir() { "a directory" } else { "none" },
            there.uid(),
            there.mode() & 0o777,
        )))
    }

    /// Locks [`Self::root`] until what is returned is dropped or this process ends. Where that cannot be, whoever looks
    /// for leftovers has processes to go by.
    pub(crate) fn hold(&self) -> Option<File> {
        let mut options = File::options();
        options.write(true).create(true).truncate(false).mode(0o600);
        let file = options.open(self.root().join(HELD)).ok()?;
        let patience = Instant::now() + GLANCE;
        loop {
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => return Some(file),
                Err(Errno::WOULDBLOCK) if Instant::now() <= patience => {
                    std::thread::sleep(Duration::from_millis(5));
                }
                Err(_) => return None,
            }
        }
    }

    /// Whether a coordinator lives whose domain this is, also one in another container that has the same shared memory:
    /// its processes are not to be seen from here, its lock is.
    pub fn is_held(&self) -> bool {
        match File::open(self.root().join(HELD)) {
            Ok(file) => {
                flock(&file, FlockOperation::NonBlockingLockShared) == Err(Errno::WOULDBLOCK)
            }
            Err(_) => false,
        }
    }

    fn refuse(&self, reason: String) -> ChannelError {
        ChannelError::Open {
            service: self.root().display().to_string(),
            reason,
            layout: proto::layout::layout_hash(),
        }
    }

    /// Shared memory that this domain takes (bytes).
    pub fn size(&self) -> u64 {
        fn size(directory: &Path) -> u64 {
            let Ok(entries) = std::fs::read_dir(directory) else { return 0 };
            let taken = |entry: DirEntry| match entry.metadata() {
                Ok(metadata) if metadata.is_dir() => size(&entry.path()),
                Ok(metadata) => metadata.blocks() * 512,
                // It has just gone.
                Err(_) => 0,
            };
            entries.flatten().map(taken).sum()
        }
        size(&self.root())
    }

    /// Removes whatever this domain left. Only call it when no process of the domain lives. What
    /// belongs to another user is none of its business, whatever it is called. Returns how many
    /// entries went.
    pub fn remove_leftovers(&self) -> std::io::Result<usize> {
        let mut removed = 0;
        let mut first = Ok(());
        for entry in own_entries(&self.0)? {
            let path = entry.path();
            let gone = if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                std::fs::remove_dir_all(&path)
            } else {
                std::fs::remove_file(&path)
            };
            match gone {
                Ok(()) => removed += 1,
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                // One that stays shall not keep the others.
                Err(error) => first = first.and(Err(error)),
            }
        }
        first.map(|()| removed)
    }

    /// Every domain of this user that has left anything on this machine.
    pub fn list() -> std::io::Result<Vec<Self>> {
        let prefix = user_prefix(own_uid());
        let names: BTreeSet<String> = own_entries(&prefix)?
            .iter()
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .filter_map(|name| name.get(..prefix.len() + 8).map(str::to_owned))
            .collect();
        Ok(names.iter().filter_map(|name| Self::parse(name).ok()).collect())
    }

    /// iceoryx2's configuration for this domain. Only the coordinator cleans up after the dead:
    /// several processes that do so at once have raced in the past.
    pub(crate) fn config(&self, cleans_up: bool) -> Config {
        let mut config = Config::default();
        let root = format!("{}/", self.root().display());
        config.global.set_root_path(
            &IpcPath::new(root.as_bytes()).expect("a domain's name is a valid path component"),
        );
        // Names are short because socket paths are limited to 108 bytes.
        config.global.prefix = FileName::new(b"o_").expect("a valid file name");
        config.global.service.cleanup_dead_nodes_on_open = cleans_up;
        config.global.node.cleanup_dead_nodes_on_creation = cleans_up;
        config.global.node.cleanup_dead_nodes_on_destruction = cleans_up;
        config.global.creation_timeout = std::time::Duration::from_secs(5);
        config
    }
}
