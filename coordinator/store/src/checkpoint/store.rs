//! A directory of checkpoints.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use super::disk::Disk;
use super::entry::{Entry, Survey, directories};
use super::guard::Guard;
use super::lock_timeout::LockTimeout;
use super::manifest::Manifest;
use super::name::Name;
use super::opening::is_directory;
use super::read::{self, Checkpoint};
use super::reserved::{BEST, LATEST, PROMOTED};
use super::{CheckpointError, catalogue};
use crate::recorded::Followed;

/// The checkpoints of a run, or any directory of checkpoints.
///
/// Any number of processes may read and change it at the same time. Readers never wait; they find
/// a checkpoint whole or not at all. Changes happen one after the other, under a lock.
#[derive(Debug, Clone)]
pub struct CheckpointStore {
    pub(super) root: PathBuf,
    pub(super) disk: Disk,
    /// What the run of the store has recorded: read once, however often it is asked for.
    pub(super) recorded: Arc<Followed>,
}

impl CheckpointStore {
    /// A store in `root`, which is made with the first commit.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into(), disk: Disk::default(), recorded: Arc::default() }
    }

    /// The same store, for somebody who waits for its lock as long as `patience` says.
    #[must_use]
    pub fn with_patience(mut self, patience: LockTimeout) -> Self {
        self.disk.patience = patience;
        self
    }

    /// Its directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The directory of the checkpoint called `name`, whether or not there is one.
    pub fn dir(&self, name: &Name) -> PathBuf {
        self.root.join(name)
    }

    /// Refuses a name that a checkpoint cannot get here: one that always selects another, one of
    /// the store's own files, and a tag.
    pub fn check_free(&self, name: &Name) -> Result<(), CheckpointError> {
        let text = name.as_str();
        let refuse = |why: String| {
            Err(CheckpointError::refused(format!("`{name}` {why}; choose another name")))
        };
        if [BEST, LATEST, PROMOTED].contains(&text) {
            return refuse("always selects another checkpoint".to_owned());
        }
        if text.bytes().all(|byte| byte.is_ascii_digit()) {
            return refuse(format!("would look like an iteration, as in RUN:{name}"));
        }
        if text.starts_with(catalogue::CATALOGUE) {
            return refuse("is a name of the catalogue's files".to_owned());
        }
        // A run's own name is never a tag, so commits need not look.
        if name.iteration().is_none()
            && let Some(holder) = self.survey()?.entries.iter().find(|e| e.labels.has_tag(text))
        {
            let holder = &holder.name;
            return refuse(format!("is a tag of {holder}, `untag` takes it away"));
        }
        Ok(())
    }

    /// Directories of the run's own checkpoints, `iteration-*`, oldest iteration first.
    pub fn list(&self) -> Result<Vec<PathBuf>, CheckpointError> {
        let own = |(name, dir): (Name, PathBuf)| name.iteration().map(|_| dir);
        Ok(directories(&self.root)?.into_iter().filter_map(own).collect())
    }

    /// The newest of the run's own checkpoints from which training can go on and that is whole. A
    /// damaged one is reported through the log and passed over, and so is one that the run has not come
    /// to itself, unless there is no other; if all are damaged, that is an error, never a silent start
    /// from nothing.
    /// Whether a run may go on from it is for the run to say, see `resume_point` of the crate `run`.
    pub fn latest(&self) -> Result<Checkpoint, CheckpointError> {
        let mut passed_over = Vec::new();
        for dir in self.by_ownership()?.into_iter().flatten() {
            if Manifest::read(&dir).is_ok_and(|manifest| !manifest.has_state()) {
                continue;
            }
            match read::load(&dir) {
                Ok(checkpoint) => {
                    for error in passed_over {
                        tracing::error!(%error, "damaged checkpoint, passed over");
                    }
                    return Ok(checkpoint);
                }
                // Removed since it was listed.
                Err(_) if !dir.exists() => {}
                Err(error) => passed_over.push(error),
            }
        }
        // The newest is the one to mend.
        Err(passed_over.into_iter().next().unwrap_or_else(|| CheckpointError::NotFound {
            path: self.root.clone(),
            what: "holds no checkpoint from which training can go on".to_owned(),
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
        Entry::read(&self.existing(name)?, name.clone())
    }

    /// The directory called `name`. A link is none: what it leads to is not the store's.
    pub(super) fn existing(&self, name: &Name) -> Result<PathBuf, CheckpointError> {
        let dir = self.dir(name);
        if is_directory(&dir) { Ok(dir) } else { Err(CheckpointError::absent(&self.root, name)) }
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
        // Where there is nothing to index, nothing is written.
        let used = self.root.join(catalogue::CATALOGUE).exists()
            || self.survey().is_ok_and(|survey| !survey.is_empty());
        if used && let Some(guard) = Guard::try_acquire(&self.root) {
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
