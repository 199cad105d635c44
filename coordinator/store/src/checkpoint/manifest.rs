//! What a checkpoint says about itself.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _};
use std::path::Path;

use proto::Digest;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::file_names::{CONFIG, FORMAT, MANIFEST, POLICY, ROBOT, STATE};
use super::{CheckpointError, opening};

/// Longest manifest that is read (bytes).
pub(super) const MAX_MANIFEST: u64 = 1 << 20;
/// Files that every checkpoint has.
pub(super) const REQUIRED: [&str; 3] = [POLICY, CONFIG, ROBOT];
/// Files that a manifest may list.
pub(super) const KNOWN: [&str; 4] = [STATE, POLICY, CONFIG, ROBOT];

/// Length and hash of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// Length (bytes).
    pub len: u64,
    /// BLAKE3, 64 hexadecimal digits.
    pub blake3: String,
}

/// Where an agent of a composed checkpoint comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// The agent here.
    pub agent: usize,
    /// Digest of the checkpoint that it was taken from.
    #[schema(value_type = String)]
    pub digest: Digest,
    /// Iterations that one had been trained on.
    pub iteration: u64,
    /// Directory of that one, as it was when it was taken.
    pub run: String,
    /// The agent there.
    pub source_agent: usize,
}

/// What a checkpoint says about itself. Never changes after the commit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of this format.
    pub format: u32,
    /// Iterations trained on; of a composed one, the most of its origins.
    pub iteration: u64,
    /// Env-steps trained on; of a composed one, the most of its origins.
    pub env_steps: u64,
    /// Digest of the training state; where there is none, of the actors' tensors.
    #[schema(value_type = String)]
    pub digest: Digest,
    /// When it was committed (seconds since 1970).
    pub created_unix_s: u64,
    /// Version, processor and threads that trained it.
    #[schema(value_type = Object)]
    pub provenance: serde_json::Value,
    /// Every other file of the directory that never changes.
    pub files: BTreeMap<String, FileEntry>,
    /// Where the agents come from, in their order; empty unless it is composed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub origins: Vec<Origin>,
}

impl Manifest {
    /// Reads the manifest of the checkpoint in `dir`.
    pub fn read(dir: &Path) -> Result<Self, CheckpointError> {
        let (_, bytes) = Self::open(dir)?;
        Self::parse(&bytes).map_err(|reason| CheckpointError::damaged(&dir.join(MANIFEST), reason))
    }

    /// The manifest of the checkpoint in `dir` as it is: open, and its bytes.
    pub fn open(dir: &Path) -> Result<(File, Vec<u8>), CheckpointError> {
        let path = dir.join(MANIFEST);
        let file = opening::file(&path).map_err(|error| match error {
            error if error.is_absence() => CheckpointError::NotFound {
                path: dir.to_owned(),
                what: format!("is no checkpoint: it has no {MANIFEST}"),
            },
            error => error,
        })?;
        let mut bytes = Vec::new();
        (&file)
            .take(MAX_MANIFEST + 1)
            .read_to_end(&mut bytes)
            .and_then(|_| (&file).rewind())
            .map_err(CheckpointError::io(&path, "read"))?;
        Ok((file, bytes))
    }

    /// Reads a manifest and checks that it lists what a checkpoint must have and nothing else.
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, String> {
        if bytes.len() as u64 > MAX_MANIFEST {
            return Err(format!("longer than {MAX_MANIFEST} bytes"));
        }
        if bytes.is_empty() {
            return Err("is empty".to_owned());
        }
        let manifest: Self =
            serde_json::from_slice(bytes).map_err(|error| format!("not a manifest: {error}"))?;
        if manifest.format != FORMAT {
            return Err(format!("format {}, this version reads {FORMAT}", manifest.format));
        }
        if let Some(missing) = REQUIRED.iter().find(|name| !manifest.files.contains_key(**name)) {
            return Err(format!("does not list {missing}"));
        }
        if let Some(unknown) = manifest.files.keys().find(|name| !KNOWN.contains(&name.as_str())) {
            return Err(format!("lists {unknown:?}, which is no file of a checkpoint"));
        }
        Ok(manifest)
    }

    /// The manifest as it is written.
    pub(super) fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec_pretty(self).expect("a manifest has a JSON form")
    }

    /// Whether training can go on from it.
    pub fn has_state(&self) -> bool {
        self.files.contains_key(STATE)
    }

    /// Length of all listed files (bytes).
    pub fn bytes(&self) -> u64 {
        self.files.values().fold(0, |sum, file| sum.saturating_add(file.len))
    }
}
