//! Reading checkpoints: nothing is believed that the manifest does not confirm.

use proto::agents::Joints;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use proto::config::{Config, Precision};
use proto::layout::{ActorLayout, Dimensions};
use safetensors::{Dtype, SafeTensors};

use super::file_names::{CONFIG, POLICY, ROBOT, STATE};
use super::manifest::{FileEntry, Manifest};
use super::tensors::{MAX_HEADER, TensorFile};
use super::{CheckpointError, opening};

/// Longest configuration or robot that is read (bytes).
pub(super) const MAX_TEXT: u64 = 1 << 20;
/// Bytes that are hashed at a time.
const BUFFER: usize = 1 << 20;

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
    /// Path of the training state. There is such a file only if the manifest
    /// [has it](Manifest::has_state).
    pub fn state(&self) -> PathBuf {
        self.dir.join(STATE)
    }

    /// The arithmetic that it was trained with. Where an earlier version left `auto` in the configuration, the
    /// training state tells.
    pub fn precision(&self) -> Result<Precision, CheckpointError> {
        const NAME: &str = "counters.precision";
        if self.config.run.precision != Precision::Auto {
            return Ok(self.config.run.precision);
        }
        let path = self.state();
        let damaged = |reason: String| CheckpointError::damaged(&path, reason);
        let file = TensorFile::open(&path).map_err(damaged)?;
        let info = file.tensors.get(NAME).filter(|info| info.dtype == Dtype::U64);
        let info = info.ok_or_else(|| damaged(format!("has no counter `{NAME}`")))?;
        let mut bytes = Vec::new();
        file.pieces(info, |piece| bytes.extend_from_slice(piece)).map_err(damaged)?;
        // Bits of the products' operands.
        match bytes.as_slice() {
            [16, 0, 0, 0, 0, 0, 0, 0] => Ok(Precision::Bf16),
            [32, 0, 0, 0, 0, 0, 0, 0] => Ok(Precision::F32),
            _ => Err(damaged(format!("`{NAME}` is neither 16 nor 32"))),
        }
    }

    /// The actors' parameters, flat, in the order of [`ActorLayout`].
    pub fn actors(&self, joints: Joints) -> Result<Vec<f32>, CheckpointError> {
        let layout = ActorLayout::new(&self.config, &Dimensions::new(&self.config, joints));
        read_policy(&self.dir.join(POLICY), &layout)
    }
}

/// Reads a file of actors: their parameters, flat, in the order of `layout`.
pub fn read_policy(path: &Path, layout: &ActorLayout) -> Result<Vec<f32>, CheckpointError> {
    // Room for tensors that are not asked for, but not for any number of them.
    let limit = 8 * layout.len as u64 + MAX_HEADER;
    let bytes = opening::bytes(path, limit)?;
    let tensors = SafeTensors::deserialize(&bytes)
        .map_err(|error| CheckpointError::damaged(path, error.to_string()))?;
    let mut flat = vec![0.0; layout.len];
    for spec in &layout.tensors {
        let tensor = tensors.tensor(&spec.name).map_err(|_| {
            CheckpointError::damaged(path, format!("tensor `{}` is missing", spec.name))
        })?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != spec.shape {
            let reason = format!(
                "tensor `{}` is {:?} {:?}, the configuration wants F32 {:?}",
                spec.name,
                tensor.dtype(),
                tensor.shape(),
                spec.shape
            );
            return Err(CheckpointError::damaged(path, reason));
        }
        for (slot, bytes) in flat[spec.range()].iter_mut().zip(tensor.data().chunks_exact(4)) {
            *slot = f32::from_le_bytes(bytes.try_into().expect("chunks of four"));
            if !slot.is_finite() {
                let reason = format!("tensor `{}` holds a number that is not finite", spec.name);
                return Err(CheckpointError::damaged(path, reason));
            }
        }
    }
    Ok(flat)
}

/// Reads a checkpoint directory and checks every listed file of it.
pub(super) fn load(dir: &Path) -> Result<Checkpoint, CheckpointError> {
    let manifest = Manifest::read(dir)?;
    for (name, entry) in &manifest.files {
        check_file(&dir.join(name), entry)?;
    }
    let (config, robot_toml) = small_files(dir)?;
    Ok(Checkpoint { dir: dir.to_owned(), manifest, config, robot_toml })
}

/// Configuration, and robot as TOML, of the checkpoint or the run in `dir`.
pub(super) fn small_files(dir: &Path) -> Result<(Config, String), CheckpointError> {
    let path = dir.join(CONFIG);
    let text = opening::text(&path, MAX_TEXT)?;
    let config = Config::from_resolved_toml(&text, &path.display().to_string())?;
    Ok((config, opening::text(&dir.join(ROBOT), MAX_TEXT)?))
}

/// Compares a file with its entry in the manifest, in pieces.
pub(super) fn check_file(path: &Path, entry: &FileEntry) -> Result<(), CheckpointError> {
    check_open(&mut opening::file(path)?, path, entry)
}

/// Compares an open file with its entry in the manifest, from its beginning to its end.
pub(super) fn check_open(
    file: &mut File,
    path: &Path,
    entry: &FileEntry,
) -> Result<(), CheckpointError> {
    let len = file.metadata().map_err(CheckpointError::io(path, "read"))?.len();
    if len != entry.len {
        let reason = format!("{len} bytes, the manifest says {}", entry.len);
        return Err(CheckpointError::damaged(path, reason));
    }
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0; BUFFER];
    loop {
        let read = file.read(&mut buffer).map_err(CheckpointError::io(path, "read"))?;
        if read == 0 {
            break;
        }
        hasher.update(&buffer[..read]);
    }
    if hasher.finalize().to_hex().as_str() != entry.blake3 {
        return Err(CheckpointError::damaged(path, "content differs from its BLAKE3 hash"));
    }
    Ok(())
}

/// Whether all listed files are there with the right length; hashes nothing.
pub(super) fn looks_whole(dir: &Path) -> bool {
    let whole = |name: &String, entry: &FileEntry| {
        let there = dir.join(name).symlink_metadata();
        there.is_ok_and(|there| there.is_file() && there.len() == entry.len)
    };
    Manifest::read(dir)
        .is_ok_and(|manifest| manifest.files.iter().all(|(name, entry)| whole(name, entry)))
}
