//! A directory of checkpoints.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use proto::config::Config;
use safetensors::SafeTensors;
use safetensors::tensor::TensorView;

use super::{
    CONFIG, Checkpoint, CheckpointError, FORMAT, FileEntry, MANIFEST, Manifest, POLICY,
    POLICY_PREFIX, ROBOT, STATE, Snapshot,
};

/// Prefix of a committed checkpoint's directory.
const COMMITTED: &str = "iteration-";
/// Prefix of a directory that is being written.
const TEMPORARY: &str = ".writing-";

/// The checkpoints of a run. One process writes, any number read.
#[derive(Debug, Clone)]
pub struct CheckpointStore {
    root: PathBuf,
}

impl CheckpointStore {
    /// A store in `root`, which is made with the first commit.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// Commits a snapshot: every file is written and synced, the manifest last, then the directory
    /// is renamed to its final name and the rename is synced. Returns the checkpoint's directory.
    ///
    /// The same iteration committed twice is the same state; the one that is there stays.
    pub fn commit(
        &self,
        snapshot: &Snapshot,
        config: &Config,
        robot_toml: &str,
        provenance: &serde_json::Value,
    ) -> Result<PathBuf, CheckpointError> {
        let name = format!("{COMMITTED}{:08}", snapshot.iteration);
        let target = self.root.join(&name);
        let temporary = self.root.join(format!("{TEMPORARY}{name}"));
        if temporary.exists() {
            fs::remove_dir_all(&temporary).map_err(CheckpointError::io(&temporary, "remove"))?;
        }
        fs::create_dir_all(&temporary).map_err(CheckpointError::io(&temporary, "create"))?;

        let (state, policy) =
            split(&snapshot.bytes).map_err(|reason| CheckpointError::Damaged {
                path: target.clone(),
                reason: format!("the learner's snapshot is no training state: {reason}"),
            })?;
        let config_toml = config.to_toml();
        let contents: [(&str, &[u8]); 4] = [
            (STATE, &state),
            (POLICY, &policy),
            (CONFIG, config_toml.as_bytes()),
            (ROBOT, robot_toml.as_bytes()),
        ];
        let mut files = BTreeMap::new();
        for (file, bytes) in contents {
            write_synced(&temporary.join(file), bytes)?;
            let blake3 = blake3::hash(bytes).to_hex().to_string();
            files.insert(file.to_owned(), FileEntry { len: bytes.len() as u64, blake3 });
        }
        let manifest = Manifest {
            format: FORMAT,
            iteration: snapshot.iteration,
            env_steps: snapshot.iteration * config.steps_per_iteration(),
            digest: snapshot.digest,
            created_unix_s: SystemTime::now()
                .duration_since(UNIX_EPOCH)
                .map_or(0, |elapsed| elapsed.as_secs()),
            provenance: provenance.clone(),
            files,
        };
        let text = serde_json::to_vec_pretty(&manifest).expect("a manifest has a JSON form");
        write_synced(&temporary.join(MANIFEST), &text)?;
        sync_dir(&temporary)?;

        if target.exists() {
            if self.load(&target).is_ok_and(|there| there.manifest.digest == snapshot.digest) {
                fs::remove_dir_all(&temporary)
                    .map_err(CheckpointError::io(&temporary, "remove"))?;
                return Ok(target);
            }
            // Damaged, or of a run whose limits were changed: out of the way, but not lost.
            let aside = self.root.join(format!(".replaced-{name}-{}", manifest.created_unix_s));
            fs::rename(&target, &aside).map_err(CheckpointError::io(&target, "rename"))?;
        }
        fs::rename(&temporary, &target).map_err(CheckpointError::io(&target, "rename"))?;
        sync_dir(&self.root)?;
        Ok(target)
    }

    /// Directories of all committed checkpoints, oldest iteration first.
    pub fn list(&self) -> Result<Vec<PathBuf>, CheckpointError> {
        let entries = match fs::read_dir(&self.root) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(CheckpointError::io(&self.root, "read")(error)),
        };
        let mut found = Vec::new();
        for entry in entries {
            let path = entry.map_err(CheckpointError::io(&self.root, "read"))?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let number = name.strip_prefix(COMMITTED).and_then(|digits| digits.parse::<u64>().ok());
            if let Some(iteration) = number {
                found.push((iteration, path));
            }
        }
        found.sort();
        Ok(found.into_iter().map(|(_, path)| path).collect())
    }

    /// The newest checkpoint that is whole. A damaged one is reported through the log and the one
    /// before is taken; if all are damaged, that is an error, never a silent start from nothing.
    pub fn latest(&self) -> Result<Checkpoint, CheckpointError> {
        let mut last_error = None;
        for dir in self.list()?.into_iter().rev() {
            match self.load(&dir) {
                Ok(checkpoint) => return Ok(checkpoint),
                Err(error) => {
                    tracing::error!(%error, "damaged checkpoint, taking the one before");
                    last_error = Some(error);
                }
            }
        }
        Err(last_error.unwrap_or_else(|| CheckpointError::NotFound {
            path: self.root.clone(),
            what: "holds no checkpoint; the run was stopped before its first one".to_owned(),
        }))
    }

    /// Reads a checkpoint's small files and checks every file against the manifest.
    pub fn load(&self, dir: &Path) -> Result<Checkpoint, CheckpointError> {
        load(dir)
    }

    /// Removes all but the `kept` newest checkpoints, and what killed commits left.
    pub fn prune(&self, kept: usize) -> Result<(), CheckpointError> {
        let mut doomed = self.list()?;
        doomed.truncate(doomed.len().saturating_sub(kept));
        for entry in fs::read_dir(&self.root).map_err(CheckpointError::io(&self.root, "read"))? {
            let path = entry.map_err(CheckpointError::io(&self.root, "read"))?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name.starts_with(TEMPORARY) {
                doomed.push(path);
            }
        }
        for dir in doomed {
            fs::remove_dir_all(&dir).map_err(CheckpointError::io(&dir, "remove"))?;
        }
        Ok(())
    }
}

/// Reads a checkpoint directory and checks every file of it.
pub(super) fn load(dir: &Path) -> Result<Checkpoint, CheckpointError> {
    let path = dir.join(MANIFEST);
    let bytes = match fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(CheckpointError::NotFound {
                path: dir.to_owned(),
                what: format!("is no checkpoint: it has no {MANIFEST}"),
            });
        }
        Err(error) => return Err(CheckpointError::io(&path, "read")(error)),
    };
    let manifest: Manifest = serde_json::from_slice(&bytes)
        .map_err(|error| CheckpointError::damaged(&path, format!("not a manifest: {error}")))?;
    if manifest.format != FORMAT {
        let reason = format!("format {}, this version reads {FORMAT}", manifest.format);
        return Err(CheckpointError::damaged(&path, reason));
    }
    let mut texts: HashMap<&str, String> = HashMap::new();
    for required in [STATE, POLICY, CONFIG, ROBOT] {
        let path = dir.join(required);
        let entry = manifest
            .files
            .get(required)
            .ok_or_else(|| CheckpointError::damaged(&path, format!("not listed in {MANIFEST}")))?;
        let bytes = fs::read(&path).map_err(CheckpointError::io(&path, "read"))?;
        if bytes.len() as u64 != entry.len {
            let reason = format!("{} bytes, the manifest says {}", bytes.len(), entry.len);
            return Err(CheckpointError::damaged(&path, reason));
        }
        if blake3::hash(&bytes).to_hex().as_str() != entry.blake3 {
            return Err(CheckpointError::damaged(&path, "content differs from its BLAKE3 hash"));
        }
        if [CONFIG, ROBOT].contains(&required) {
            let text = String::from_utf8(bytes)
                .map_err(|_| CheckpointError::damaged(&path, "not UTF-8"))?;
            texts.insert(required, text);
        }
    }
    let mut text = |name: &str| texts.remove(name).expect("read above");
    let origin = dir.join(CONFIG).display().to_string();
    let config = Config::from_resolved_toml(&text(CONFIG), &origin)?;
    Ok(Checkpoint { dir: dir.to_owned(), manifest, config, robot_toml: text(ROBOT) })
}

/// Splits a snapshot into the training state and the actors.
fn split(bytes: &[u8]) -> Result<(Vec<u8>, Vec<u8>), String> {
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| error.to_string())?;
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| error.to_string())?;
    let mut policy: Vec<(String, TensorView<'_>)> = Vec::new();
    let mut state = Vec::new();
    for (name, view) in tensors.tensors() {
        match name.strip_prefix(POLICY_PREFIX) {
            Some(name) => policy.push((name.to_owned(), view)),
            None => state.push((name, view)),
        }
    }
    if policy.is_empty() || state.is_empty() {
        return Err(format!("{} policy and {} state tensors", policy.len(), state.len()));
    }
    let write = |tensors, metadata| {
        safetensors::serialize(tensors, metadata).map_err(|error| error.to_string())
    };
    Ok((write(state, metadata.metadata().clone())?, write(policy, None)?))
}

fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), CheckpointError> {
    let write = || {
        let mut file = File::create(path)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(CheckpointError::io(path, "write"))
}

fn sync_dir(path: &Path) -> Result<(), CheckpointError> {
    File::open(path).and_then(|dir| dir.sync_all()).map_err(CheckpointError::io(path, "sync"))
}
