//! A directory of checkpoints.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use proto::Digest;
use proto::config::Config;

use super::disk::Disk;
use super::entry::{Entry, Survey, directories};
use super::guard::{Guard, Scratch, unique};
use super::labels::Labels;
use super::manifest::{FileEntry, Manifest};
use super::name::Name;
use super::read::{self, Checkpoint};
use super::{
    CONFIG, CheckpointError, FORMAT, MANIFEST, POLICY, ROBOT, STATE, Snapshot, catalogue, tensors,
};

/// Prefix of a checkpoint that another one has replaced.
const REPLACED: &str = ".replaced-";

/// The checkpoints of a run, or any directory of checkpoints.
///
/// Any number of processes may read and change it at the same time. Readers never wait; they find
/// a checkpoint whole or not at all. Changes happen one after the other, under a lock.
#[derive(Debug, Clone)]
pub struct CheckpointStore {
    pub(super) root: PathBuf,
    pub(super) disk: Disk,
}

/// What to do with another checkpoint that has the name already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Clash {
    /// Put it aside.
    Replace,
    /// Leave it, unless it is damaged.
    Refuse,
}

impl CheckpointStore {
    /// A store in `root`, which is made with the first commit.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into(), disk: Disk::default() }
    }

    /// Its directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The directory of the checkpoint called `name`, whether or not there is one.
    pub fn dir(&self, name: &Name) -> PathBuf {
        self.root.join(name)
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
        let name = Name::of_iteration(snapshot.iteration);
        let (state, policy) =
            tensors::split(&snapshot.bytes).map_err(|reason| CheckpointError::Damaged {
                path: self.dir(&name),
                reason: format!("the learner's snapshot is no training state: {reason}"),
            })?;
        let config_toml = config.to_toml();
        let contents: [(&str, &[u8]); 4] = [
            (STATE, &state),
            (POLICY, &policy),
            (CONFIG, config_toml.as_bytes()),
            (ROBOT, robot_toml.as_bytes()),
        ];
        let manifest = Manifest {
            format: FORMAT,
            iteration: snapshot.iteration,
            env_steps: snapshot.iteration * config.steps_per_iteration(),
            digest: snapshot.digest,
            created_unix_s: now(),
            provenance: provenance.clone(),
            files: BTreeMap::new(),
            origins: Vec::new(),
        };
        self.write(&name, &contents, manifest, Clash::Replace)
    }

    /// Writes a new checkpoint under any name and publishes it. `manifest` lists no files yet.
    pub(super) fn write(
        &self,
        name: &Name,
        contents: &[(&str, &[u8])],
        mut manifest: Manifest,
        clash: Clash,
    ) -> Result<PathBuf, CheckpointError> {
        let scratch = Scratch::new(&self.disk, &self.root, name.as_str())?;
        for (file, bytes) in contents {
            self.disk.write_file(&scratch.path().join(file), bytes)?;
            let blake3 = blake3::hash(bytes).to_hex().to_string();
            manifest
                .files
                .insert((*file).to_owned(), FileEntry { len: bytes.len() as u64, blake3 });
        }
        self.disk.write_file(&scratch.path().join(MANIFEST), &manifest.to_json())?;
        self.publish(scratch, name, manifest.digest, clash)
    }

    /// Gives a whole directory its final name; the same checkpoint twice stays as it was.
    pub(super) fn publish(
        &self,
        scratch: Scratch<'_>,
        name: &Name,
        digest: Digest,
        clash: Clash,
    ) -> Result<PathBuf, CheckpointError> {
        self.disk.sync_dir(scratch.path())?;
        let target = self.dir(name);
        let guard = self.guard()?;
        let mut aside = None;
        if target.symlink_metadata().is_ok() {
            match read::load(&target) {
                Ok(there) if there.manifest.digest == digest => {
                    scratch.discard()?;
                    return Ok(target);
                }
                Ok(there) if clash == Clash::Refuse => {
                    let reason = format!(
                        "is another checkpoint already, with digest {} instead of {digest}; \
                         choose another name, or delete that one first",
                        there.manifest.digest
                    );
                    return Err(CheckpointError::Conflict { path: target, reason });
                }
                Err(error @ CheckpointError::Io { .. }) if !error.is_absence() => {
                    return Err(error);
                }
                // Damaged, or of a run whose limits were changed: out of the way, but not lost.
                there => {
                    if there.is_err()
                        && let Ok(labels) = Labels::try_read(&target)
                        && labels != Labels::default()
                    {
                        // Mended, it is what its users have pinned and tagged.
                        labels.write(&self.disk, scratch.path())?;
                    }
                    let away = unique(&self.root, REPLACED, name.as_str());
                    self.disk.rename(&target, &away)?;
                    aside = Some(away);
                }
            }
        }
        if let Err(error) = scratch.publish(&target, &guard) {
            if let Some(away) = aside {
                // The error above is the one to report.
                let _ = self.disk.rename(&away, &target);
            }
            return Err(error);
        }
        self.disk.sync_dir(&self.root)?;
        self.finish(&guard, &[name]);
        Ok(target)
    }

    /// Directories of the run's own checkpoints, `iteration-*`, oldest iteration first.
    pub fn list(&self) -> Result<Vec<PathBuf>, CheckpointError> {
        let own = |(name, dir): (Name, PathBuf)| name.iteration().map(|_| dir);
        Ok(directories(&self.root)?.into_iter().filter_map(own).collect())
    }

    /// The newest of the run's own checkpoints from which training can go on and that is whole. A
    /// damaged one is reported through the log and the one before is taken; if all are damaged,
    /// that is an error, never a silent start from nothing.
    pub fn latest(&self) -> Result<Checkpoint, CheckpointError> {
        let mut last_error = None;
        for dir in self.list()?.into_iter().rev() {
            if Manifest::read(&dir).is_ok_and(|manifest| !manifest.has_state()) {
                continue;
            }
            match read::load(&dir) {
                Ok(checkpoint) => return Ok(checkpoint),
                // Removed since it was listed.
                Err(_) if !dir.exists() => {}
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
        read::load(dir)
    }

    /// All checkpoints at a glance, the run's own last and in order of iteration. Those whose
    /// manifest is unreadable are left out and reported through the log.
    pub fn entries(&self) -> Result<Vec<Entry>, CheckpointError> {
        let survey = self.survey()?;
        for damaged in &survey.damaged {
            tracing::warn!(reason = damaged.reason, "damaged checkpoint");
        }
        Ok(survey.entries)
    }

    /// All checkpoints at a glance, and what is damaged.
    pub fn survey(&self) -> Result<Survey, CheckpointError> {
        Survey::of(&self.root)
    }

    /// The checkpoint called `name` at a glance.
    pub fn entry(&self, name: &Name) -> Result<Entry, CheckpointError> {
        let dir = self.dir(name);
        if !dir.is_dir() {
            return Err(CheckpointError::absent(&self.root, name));
        }
        Entry::read(&dir, name.clone())
    }

    /// Rebuilds the catalogue from the manifests, puts the tag `best` where the scores say, and
    /// returns the number of checkpoints.
    pub fn rebuild(&self) -> Result<usize, CheckpointError> {
        let guard = self.guard()?;
        self.settle_best(&guard)?;
        let survey = self.survey()?;
        catalogue::rebuild(&self.root, &survey.entries)?;
        Ok(survey.entries.len())
    }

    /// Brings the catalogue up to date if it is not and nobody is changing the store meanwhile.
    pub fn heal_catalogue(&self) {
        if self.root.is_dir()
            && let Some(guard) = Guard::try_acquire(&self.root)
        {
            self.index(&guard, &[]);
        }
    }

    /// The exclusive right to change the store.
    pub(super) fn guard(&self) -> Result<Guard, CheckpointError> {
        Guard::acquire(&self.disk, &self.root)
    }

    /// Ends a change of the checkpoints in `touched`: the tag `best` and the catalogue follow.
    /// What was done stands, so a failure is a warning.
    pub(super) fn finish(&self, guard: &Guard, touched: &[&Name]) {
        if let Err(error) = self.settle_best(guard) {
            tracing::warn!(%error, "the tag `best` could not be moved");
        }
        self.index(guard, touched);
    }

    /// Writes the catalogue. It is an index, never the truth, so a failure is a warning.
    fn index(&self, _: &Guard, touched: &[&Name]) {
        let path = self.root.join(catalogue::CATALOGUE);
        let written = self.survey().and_then(|survey| {
            self.disk.step("index", &path, || Ok(()))?;
            catalogue::refresh(&self.root, &survey.entries, touched)
        });
        if let Err(error) = written {
            tracing::warn!(%error, "the catalogue could not be written");
        }
    }
}

/// Seconds since 1970.
pub(super) fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs())
}
