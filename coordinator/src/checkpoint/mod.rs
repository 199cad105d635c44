//! Checkpoints: committed snapshots of a training state, one directory each.
//!
//! ```text
//! checkpoints/iteration-00000050/
//!   state.safetensors    everything that training needs to go on
//!   policy.safetensors   the actors alone, one row an agent, as workers run them
//!   config.toml          the resolved configuration
//!   robot.toml           the robot's description
//!   manifest.json        written last: counters, digest, length and BLAKE3 of every file
//! ```
//!
//! A checkpoint exists if and only if its directory has its final name. It gets that name by one
//! rename, after every byte of it has reached the disk, so a kill or a power cut at any moment
//! leaves either the whole checkpoint or none. See [`CheckpointStore::commit`].

mod assembly;
mod store;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions};
use proto::{ConfigError, Digest};
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

pub use assembly::{Assembly, Snapshot};
pub use store::CheckpointStore;

/// The format that this version writes.
pub const FORMAT: u32 = 1;
/// Name of the file that makes a directory a checkpoint.
pub const MANIFEST: &str = "manifest.json";
/// Name of the training state.
pub const STATE: &str = "state.safetensors";
/// Name of the actors.
pub const POLICY: &str = "policy.safetensors";
/// Name of the resolved configuration.
pub const CONFIG: &str = "config.toml";
/// Name of the robot's description.
pub const ROBOT: &str = "robot.toml";
/// Prefix of the actors' tensors inside a snapshot.
const POLICY_PREFIX: &str = "policy.";

/// What can be wrong with checkpoints.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
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
}

impl CheckpointError {
    fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }

    fn damaged(path: &Path, reason: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), reason: reason.into() }
    }
}

/// Length and hash of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// Length (bytes).
    pub len: u64,
    /// BLAKE3, 64 hexadecimal digits.
    pub blake3: String,
}

/// What a checkpoint says about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of this format.
    pub format: u32,
    /// Iterations trained on.
    pub iteration: u64,
    /// Env-steps trained on.
    pub env_steps: u64,
    /// Digest of the training state.
    pub digest: Digest,
    /// When it was committed (seconds since 1970).
    pub created_unix_s: u64,
    /// Version, processor and threads that trained it.
    pub provenance: serde_json::Value,
    /// Every other file of the directory.
    pub files: BTreeMap<String, FileEntry>,
}

/// A checkpoint that was found whole.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    /// Its directory.
    pub dir: PathBuf,
    /// Its manifest.
    pub manifest: Manifest,
    /// Its configuration.
    pub config: Config,
    /// Its robot, as TOML.
    pub robot_toml: String,
}

impl Checkpoint {
    /// Path of the training state.
    pub fn state(&self) -> PathBuf {
        self.dir.join(STATE)
    }

    /// The actors' parameters, flat, in the order of [`ActorLayout`].
    pub fn actors(&self, n_arms: usize) -> Result<Vec<f32>, CheckpointError> {
        let layout = ActorLayout::new(&self.config, &Dimensions::new(&self.config, n_arms));
        let path = self.dir.join(POLICY);
        let bytes = std::fs::read(&path).map_err(CheckpointError::io(&path, "read"))?;
        let tensors = SafeTensors::deserialize(&bytes)
            .map_err(|error| CheckpointError::damaged(&path, error.to_string()))?;
        let mut flat = vec![0.0; layout.len];
        for spec in &layout.tensors {
            let tensor = tensors.tensor(&spec.name).map_err(|_| {
                CheckpointError::damaged(&path, format!("tensor `{}` is missing", spec.name))
            })?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != spec.shape {
                let reason = format!(
                    "tensor `{}` is {:?} {:?}, the configuration wants F32 {:?}",
                    spec.name,
                    tensor.dtype(),
                    tensor.shape(),
                    spec.shape
                );
                return Err(CheckpointError::damaged(&path, reason));
            }
            for (slot, bytes) in flat[spec.range()].iter_mut().zip(tensor.data().chunks_exact(4)) {
                *slot = f32::from_le_bytes(bytes.try_into().expect("chunks of four"));
                if !slot.is_finite() {
                    let reason =
                        format!("tensor `{}` holds a number that is not finite", spec.name);
                    return Err(CheckpointError::damaged(&path, reason));
                }
            }
        }
        Ok(flat)
    }
}

#[cfg(test)]
mod tests;
