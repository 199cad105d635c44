//! What can be wrong with checkpoints.

use std::path::{Path, PathBuf};

use proto::ConfigError;

use super::name::{Name, NameError};

/// What can be wrong with checkpoints.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// There is none of this name.
    #[error(
        "{root}: has no checkpoint `{name}`; `octopus checkpoints list` shows what it has",
        root = root.display()
    )]
    Absent {
        /// The store.
        root: PathBuf,
        /// The name.
        name: Name,
    },
    /// There is none.
    #[error("{path}: {what}", path = path.display())]
    NotFound {
        /// Where it was looked for.
        path: PathBuf,
        /// What is missing, and what to do.
        what: String,
    },
    /// Something in it is not as it was committed.
    #[error("{path}: {reason}", path = path.display())]
    Damaged {
        /// The file or directory.
        path: PathBuf,
        /// How it shows.
        reason: String,
    },
    /// Reading or writing failed.
    #[error("{path}: cannot {action}: {source}", path = path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// `read`, `write`, `rename`, …
        action: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Its configuration is not readable.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A name or tag that cannot be one.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Another checkpoint has the name already.
    #[error("{path}: {reason}", path = path.display())]
    Conflict {
        /// The checkpoint that is there.
        path: PathBuf,
        /// How they differ, and what to do.
        reason: String,
    },
    /// It is pinned, so it is not removed.
    #[error(
        "{path}: is pinned; `octopus checkpoints unpin {typed}` lets it go",
        path = path.display(),
        typed = output::quoted(path)
    )]
    Pinned {
        /// The checkpoint.
        path: PathBuf,
    },
    /// It is the one from which its run goes on, so it is not removed.
    #[error(
        "{path}: {reason}",
        path = path.display(),
        reason = newest(*live, "--force removes it all the same")
    )]
    Newest {
        /// The checkpoint.
        path: PathBuf,
        /// Whether the run is going on.
        live: bool,
    },
    /// Another program has the right to change the store.
    #[error(
        "{path}: another program{who} has held this lock for {seconds:.0} s; nothing was changed; try \
         again when it is done, or end it",
        path = path.display(),
        who = pid.map_or_else(String::new, |pid| format!(" (process {pid})"))
    )]
    Locked {
        /// The lock file.
        path: PathBuf,
        /// How long it was waited for (s).
        seconds: f64,
        /// The other program's process, if that is known.
        pid: Option<u32>,
    },
    /// What was asked for cannot be; nothing was changed.
    #[error("{reason}")]
    Refused {
        /// Why, and what to do.
        reason: String,
    },
    /// The bytes are no archive of a checkpoint.
    #[error("not an archive of a checkpoint: {reason}")]
    Archive {
        /// What was found, and what was expected.
        reason: String,
    },
}

impl CheckpointError {
    pub(super) fn io(
        path: &Path,
        action: &'static str,
    ) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }

    pub(super) fn damaged(path: &Path, reason: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), reason: reason.into() }
    }

    pub(super) fn refused(reason: impl Into<String>) -> Self {
        Self::Refused { reason: reason.into() }
    }

    pub(super) fn archive(reason: impl Into<String>) -> Self {
        Self::Archive { reason: reason.into() }
    }

    pub(super) fn absent(root: &Path, name: &Name) -> Self {
        Self::Absent { root: root.to_owned(), name: name.clone() }
    }

    /// Says what to do where a checkpoint that was asked for, of the store at `root`, is not as it was committed.
    #[must_use]
    pub(super) fn or_another(self, root: &Path) -> Self {
        match self {
            Self::Damaged { path, reason } => {
                let list = output::quoted(root);
                let cure = "the checkpoint is damaged: copy it again, or take another one";
                let reason = format!("{reason}; {cure} (`octopus checkpoints list {list}`)");
                Self::Damaged { path, reason }
            }
            other => other,
        }
    }

    /// Whether the file that could not be read does not exist.
    pub(super) fn is_absence(&self) -> bool {
        match self {
            Self::Absent { .. } | Self::NotFound { .. } => true,
            Self::Io { source, .. } => source.kind() == std::io::ErrorKind::NotFound,
            _ => false,
        }
    }
}

/// Why the newest whole checkpoint of a run stays; `cure` is what to do while nobody needs it.
pub fn newest(live: bool, cure: &str) -> String {
    let is = "is the newest whole checkpoint of its run";
    if live {
        format!("{is}, which is going on and falls back to it; stop the run first")
    } else {
        format!("{is}, from which `octopus resume` goes on; {cure}")
    }
}
