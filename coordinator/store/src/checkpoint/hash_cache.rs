//! Files that are served again and again are hashed once.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Seek as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::CheckpointError;
use super::manifest::{FileEntry, Manifest};
use super::opening;
use super::read::{Checkpoint, check_open, small_files};
use crate::stamp::Stamp;

/// Files beyond which those are forgotten that are gone.
const REMEMBERED: usize = 1024;

/// What a file was when it was compared with its entry in the manifest.
#[derive(Debug)]
struct CheckResult {
    stamp: Stamp,
    entry: FileEntry,
    /// What was wrong with it.
    damage: Option<String>,
}

/// Remembers which files were found to be as their manifest says, and which not. A file that has
/// been written to or replaced since is hashed anew.
#[derive(Debug, Default)]
pub struct Checked {
    /// A lock for each file, so that two who ask for one at the same time hash it once.
    files: Mutex<BTreeMap<PathBuf, Arc<Mutex<Option<CheckResult>>>>>,
}

impl Checked {
    /// Opens a file of a checkpoint, and says if it is not as `entry` in its manifest says.
    pub fn open(&self, path: &Path, entry: &FileEntry) -> Result<File, CheckpointError> {
        let mut file = opening::file(path)?;
        let metadata = file.metadata().map_err(CheckpointError::io(path, "read"))?;
        let stamp = Stamp::of(&metadata);
        let slot = self.slot(path);
        let mut known = lock(&slot);
        if !known.as_ref().is_some_and(|known| known.stamp == stamp && known.entry == *entry) {
            let damage = match check_open(&mut file, path, entry) {
                Ok(()) => None,
                Err(CheckpointError::Damaged { path, reason }) => {
                    tracing::error!(path = %path.display(), reason, "damaged checkpoint");
                    Some(reason)
                }
                Err(error) => return Err(error),
            };
            file.rewind().map_err(CheckpointError::io(path, "read"))?;
            *known = Some(CheckResult { stamp, entry: entry.clone(), damage });
        }
        match known.as_ref().and_then(|known| known.damage.as_ref()) {
            None => Ok(file),
            Some(damage) => Err(CheckpointError::damaged(path, damage)),
        }
    }

    /// Says if something in the checkpoint in `dir` is not as it was committed.
    pub fn check(&self, dir: &Path) -> Result<(), CheckpointError> {
        let manifest = Manifest::read(dir)?;
        manifest
            .files
            .iter()
            .try_for_each(|(name, entry)| self.open(&dir.join(name), entry).map(drop))
    }

    /// The checkpoint in `dir`, if it is whole.
    pub fn load(&self, dir: &Path) -> Result<Checkpoint, CheckpointError> {
        self.check(dir)?;
        let (config, robot_toml) = small_files(dir)?;
        Ok(Checkpoint { dir: dir.to_owned(), manifest: Manifest::read(dir)?, config, robot_toml })
    }

    fn slot(&self, path: &Path) -> Arc<Mutex<Option<CheckResult>>> {
        let mut files = lock(&self.files);
        if files.len() >= REMEMBERED && !files.contains_key(path) {
            files.retain(|path, _| path.exists());
        }
        Arc::clone(files.entry(path.to_owned()).or_default())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
