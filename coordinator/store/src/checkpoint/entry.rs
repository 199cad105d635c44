//! A checkpoint at a glance: what its manifest and its labels say.

use std::path::{Path, PathBuf};

use proto::Digest;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::CheckpointError;
use super::file_names::MANIFEST;
use super::labels::Labels;
use super::manifest::{Manifest, Origin};
use super::name::Name;

/// What a checkpoint is good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Training can go on from it.
    Training,
    /// Holds the actors only.
    Policy,
    /// Holds actors of several checkpoints.
    Composed,
}

impl Kind {
    /// The kind as it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Training => "training",
            Self::Policy => "policy",
            Self::Composed => "composed",
        }
    }
}

/// A checkpoint at a glance. Reading one hashes nothing, so it says nothing about damage to the
/// large files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Entry {
    /// Its name.
    pub name: Name,
    /// Its directory.
    #[schema(value_type = String)]
    pub dir: PathBuf,
    /// What it is good for.
    pub kind: Kind,
    /// Iterations trained on.
    pub iteration: u64,
    /// Env-steps trained on.
    pub env_steps: u64,
    /// Digest of the training state, or of the actors where there is none.
    #[schema(value_type = String)]
    pub digest: Digest,
    /// When it was committed (seconds since 1970).
    pub created_unix_s: u64,
    /// Length of its files (bytes).
    pub bytes: u64,
    /// What users and runs say about it.
    pub labels: Labels,
    /// Where its agents come from, if it is composed.
    pub origins: Vec<Origin>,
}

impl Entry {
    /// Reads manifest and labels of the checkpoint in `dir`.
    pub(super) fn read(dir: &Path, name: Name) -> Result<Self, CheckpointError> {
        let manifest = Manifest::read(dir)?;
        let kind = match (manifest.has_state(), manifest.origins.is_empty()) {
            (true, _) => Kind::Training,
            (false, true) => Kind::Policy,
            (false, false) => Kind::Composed,
        };
        Ok(Self {
            name,
            dir: dir.to_owned(),
            kind,
            iteration: manifest.iteration,
            env_steps: manifest.env_steps,
            digest: manifest.digest,
            created_unix_s: manifest.created_unix_s,
            bytes: manifest.bytes(),
            labels: Labels::read(dir),
            origins: manifest.origins,
        })
    }
}

/// A directory with the name of a checkpoint whose manifest cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DamagedEntry {
    /// Its name.
    pub name: Name,
    /// Its directory.
    #[schema(value_type = String)]
    pub dir: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

/// Everything in a store, the run's own checkpoints last and in order of iteration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Survey {
    /// Checkpoints whose manifest is readable.
    pub entries: Vec<Entry>,
    /// The others.
    pub damaged: Vec<DamagedEntry>,
}

impl Survey {
    /// Whether nothing is there, not even a damaged checkpoint.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty() && self.damaged.is_empty()
    }

    /// Looks at every directory in `root`; one that vanishes meanwhile is left out.
    pub(super) fn of(root: &Path) -> Result<Self, CheckpointError> {
        let mut survey = Self::default();
        for (name, dir) in directories(root)? {
            match Entry::read(&dir, name.clone()) {
                Ok(entry) => survey.entries.push(entry),
                // Removed since, or a directory that never was a checkpoint.
                Err(_) if !dir.is_dir() => {}
                Err(error) if error.is_absence() && name.iteration().is_none() => {}
                Err(error) => {
                    survey.damaged.push(DamagedEntry { name, dir, reason: error.to_string() });
                }
            }
        }
        Ok(survey)
    }
}

/// Directories in `root` whose name can be a checkpoint's: others first, then the run's own by
/// iteration. A `root` that does not exist holds none.
pub(super) fn directories(root: &Path) -> Result<Vec<(Name, PathBuf)>, CheckpointError> {
    let entries = match std::fs::read_dir(root) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(CheckpointError::io(root, "read")(error)),
    };
    let mut found: Vec<(Name, PathBuf)> = Vec::new();
    for entry in entries {
        let entry = entry.map_err(CheckpointError::io(root, "read"))?;
        // A link is no checkpoint: removing it would remove what it leads to.
        let is_dir = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let path = entry.path();
        let name = path.file_name().and_then(|name| name.to_str()).map(str::parse::<Name>);
        if let Some(Ok(name)) = name
            && is_dir
            && (name.iteration().is_some() || path.join(MANIFEST).exists())
        {
            found.push((name, path));
        }
    }
    found.sort_by(|(a, _), (b, _)| (a.iteration(), a).cmp(&(b.iteration(), b)));
    Ok(found)
}
