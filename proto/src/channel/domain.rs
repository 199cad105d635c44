//! The name under which a run's shared resources live.

use std::path::PathBuf;

use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, Path, SemanticString};

use crate::ChannelError;

/// Names all shared-memory segments, sockets and files of one run.
///
/// iceoryx2's root path alone does not separate shared memory, so the name is also the prefix of
/// every segment. It holds the user's id: another user's run is never touched.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain(String);

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
        Self(format!("{}{}", user_prefix(rustix::process::getuid().as_raw()), &hash[..8]))
    }

    /// Parses a name that [`Self::as_str`] gave; refuses what does not belong to this user.
    pub fn parse(name: &str) -> Result<Self, ChannelError> {
        let prefix = user_prefix(rustix::process::getuid().as_raw());
        let valid = name.strip_prefix(&prefix).is_some_and(|rest| {
            rest.len() == 8 && rest.bytes().all(|byte| byte.is_ascii_hexdigit())
        });
        if valid {
            return Ok(Self(name.to_owned()));
        }
        Err(ChannelError::Open {
            service: name.to_owned(),
            reason: format!("not a domain of this user: {prefix} and eight hexadecimal digits"),
            layout: crate::layout::layout_hash(),
        })
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The directory with iceoryx2's files; short, because socket paths are limited to 108 bytes.
    pub fn root(&self) -> PathBuf {
        PathBuf::from("/tmp").join(&self.0)
    }

    /// Removes whatever this domain left: segments and files. Only call it when no process of the
    /// domain lives. Returns how many entries went.
    pub fn remove_leftovers(&self) -> std::io::Result<usize> {
        let mut removed = 0;
        for directory in ["/dev/shm", "/tmp"] {
            for entry in std::fs::read_dir(directory)? {
                let entry = entry?;
                if !entry.file_name().to_string_lossy().starts_with(&self.0) {
                    continue;
                }
                let is_directory = entry.file_type()?.is_dir();
                let path = entry.path();
                if is_directory {
                    std::fs::remove_dir_all(&path)?;
                } else {
                    std::fs::remove_file(&path)?;
                }
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Every domain of this user that has left anything on this machine.
    pub fn list() -> std::io::Result<Vec<Self>> {
        let prefix = user_prefix(rustix::process::getuid().as_raw());
        let mut names = std::collections::BTreeSet::new();
        for directory in ["/dev/shm", "/tmp"] {
            for entry in std::fs::read_dir(directory)? {
                let name = entry?.file_name().to_string_lossy().into_owned();
                if name.starts_with(&prefix) && name.is_char_boundary(prefix.len() + 8) {
                    names.insert(name.chars().take(prefix.len() + 8).collect::<String>());
                }
            }
        }
        Ok(names.iter().filter_map(|name| Self::parse(name).ok()).collect())
    }

    /// iceoryx2's configuration for this domain. Only the coordinator cleans up after the dead:
    /// several processes that do so at once have raced in the past.
    pub(super) fn config(&self, cleans_up: bool) -> Config {
        let mut config = Config::default();
        let root = format!("{}/", self.root().display());
        config.global.set_root_path(
            &Path::new(root.as_bytes()).expect("a domain's name is a valid path component"),
        );
        config.global.prefix = FileName::new(format!("{}_", self.0).as_bytes())
            .expect("a domain's name is a valid file name");
        config.global.service.cleanup_dead_nodes_on_open = cleans_up;
        config.global.node.cleanup_dead_nodes_on_creation = cleans_up;
        config.global.node.cleanup_dead_nodes_on_destruction = cleans_up;
        config.global.creation_timeout = std::time::Duration::from_secs(5);
        config
    }
}
