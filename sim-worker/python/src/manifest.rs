//! What a checkpoint says of its files: every one is held against its length and BLAKE3 hash before it is believed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use proto::Digest;
use serde::Deserialize;

use crate::config::{hash, read};

/// Name of the file that makes a directory a checkpoint.
pub(crate) const MANIFEST: &str = "manifest.json";
const FORMAT: u32 = 1;
/// What training goes on from.
const STATE: &str = "state.safetensors";
/// Longest manifest, and longest file of a checkpoint (bytes).
const MAX_MANIFEST: u64 = 1 << 20;
const MAX_FILE: u64 = 1 << 36;

/// What is known of a checkpoint before its files are read.
#[derive(Deserialize)]
pub(crate) struct Manifest {
    format: u32,
    pub(crate) iteration: u64,
    pub(crate) env_steps: u64,
    pub(crate) digest: Digest,
    files: BTreeMap<String, Entry>,
}

#[derive(Deserialize)]
struct Entry {
    len: u64,
    blake3: String,
}

impl Manifest {
    /// That of the checkpoint in a directory.
    pub(crate) fn read(dir: &Path) -> Result<Self, String> {
        let path = dir.join(MANIFEST);
        let shown = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let bytes = read(&path, MAX_MANIFEST).map_err(|error| shown(&error))?;
        let manifest: Self = serde_json::from_slice(&bytes)
            .map_err(|error| shown(&format!("not a manifest: {error}")))?;
        if manifest.format != FORMAT {
            return Err(shown(&format!("format {}, this version reads {FORMAT}", manifest.format)));
        }
        Ok(manifest)
    }

    /// Whether training can go on from it.
    pub(crate) fn has_state(&self) -> bool {
        self.files.contains_key(STATE)
    }

    /// Whether all files are in `dir` with the right length; hashes nothing.
    pub(crate) fn looks_whole(&self, dir: &Path) -> bool {
        self.files.iter().all(|(name, entry)| {
            let there = dir.join(name).symlink_metadata();
            there.is_ok_and(|there| there.is_file() && there.len() == entry.len)
        })
    }

    /// Holds every file in `dir` against its hash.
    pub(crate) fn check(&self, dir: &Path) -> Result<(), String> {
        for (name, entry) in &self.files {
            let path = dir.join(name);
            let shown = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
            // A state may be longer than memory.
            let (len, hash) = hash(&path, MAX_FILE).map_err(|error| shown(&error))?;
            entry.admits(len, &hash).map_err(|reason| shown(&reason))?;
        }
        Ok(())
    }

    /// A file in `dir`, of `limit` bytes at most.
    pub(crate) fn content(
        &self,
        dir: &Path,
        name: &str,
        limit: u64,
    ) -> Result<(PathBuf, Vec<u8>), String> {
        let shown =
            |path: &Path, error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let path = dir.join(name);
        let entry = self.files.get(name);
        let entry =
            entry.ok_or_else(|| shown(&dir.join(MANIFEST), &format!("does not list {name}")))?;
        let bytes = read(&path, limit).map_err(|error| shown(&path, &error))?;
        let admitted = entry.admits(bytes.len() as u64, &blake3::hash(&bytes));
        admitted.map_err(|reason| shown(&path, &reason))?;
        Ok((path, bytes))
    }
}

impl Entry {
    /// Why a file of this length and hash is not the one that is meant.
    fn admits(&self, len: u64, hash: &blake3::Hash) -> Result<(), String> {
        if len != self.len {
            return Err(format!("{len} bytes, the manifest says {}", self.len));
        }
        if hash.to_hex().as_str() != self.blake3 {
            return Err("content differs from its BLAKE3 hash".to_owned());
        }
        Ok(())
    }
}
