//! A directory of checkpoints.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use proto::Digest;
use proto::config::Config;

use super::disk::Disk;
use super::entry::{Entry, Survey, directories};
use super::guard::{Guard, REPLACED, Scratch, unique};
use super::labelling::{BEST, LATEST};
use super::labels::{Labels, Score};
use super::lock_timeout::LockTimeout;
use super::manifest::{FileEntry, Manifest};
use super::name::Name;
use super::opening::{Stamp, is_directory};
use super::read::{self, Checkpoint};
use super::{
    CONFIG, CheckpointError, FORMAT, MANIFEST, POLICY, ROBOT, STATE, Snapshot, catalogue, tensors,
};

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

/// A checkpoint that is to be published.
#[derive(Debug)]
pub(super) struct Arrival<'a> {
    pub(super) name: &'a Name,
    pub(super) digest: Digest,
    pub(super) clash: Clash,
    /// What is known about it already.
    pub(super) score: Option<Score>,
    /// Whether it comes from outside.
    pub(super) imported: bool,
}

/// Where a commit ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placement {
    /// The checkpoint's directory.
    pub dir: PathBuf,
    /// Whether it has the tag `best` now.
    pub best: bool,
}

/// What has a name already.
#[derive(Debug)]
enum Occupant {
    Nobody,
    /// The same checkpoint, whole.
    Same,
    /// Another one, whole, with this digest.
    Other(Digest),
    /// A checkpoint that cannot be read.
    Damaged,
    /// What never was a checkpoint.
    Stranger,
}

impl CheckpointStore {
    /// A store in `root`, which is made with the first commit.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into(), disk: Disk::default() }
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
        let placement = self.commit_scored(snapshot, config, robot_toml, provenance, None)?;
        Ok(placement.dir)
    }

    /// Commits a snapshot together with its score, in one step: the checkpoint appears with its
    /// labels, and the tag `best` has moved before anybody else may change the store. So a
    /// [retention](Self::retain) after it never takes the new best for an unscored one.
    ///
    /// Of a checkpoint that is there already the score is replaced, if one is given.
    pub fn commit_scored(
        &self,
        snapshot: &Snapshot,
        config: &Config,
        robot_toml: &str,
        provenance: &serde_json::Value,
        score: Option<Score>,
    ) -> Result<Placement, CheckpointError> {
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
        if let Some(score) = &score {
            score.check(&name)?;
        }
        let clash = Clash::Replace;
        let arrival =
            Arrival { name: &name, digest: manifest.digest, clash, score, imported: false };
        self.write(arrival, &contents, manifest)
    }

    /// Writes a new checkpoint and publishes it. `manifest` lists no files yet.
    pub(super) fn write(
        &self,
        arrival: Arrival<'_>,
        contents: &[(&str, &[u8])],
        mut manifest: Manifest,
    ) -> Result<Placement, CheckpointError> {
        let scratch = Scratch::new(&self.disk, &self.root, arrival.name.as_str())?;
        for (file, bytes) in contents {
            self.disk.write_file(&scratch.path().join(file), bytes)?;
            let blake3 = blake3::hash(bytes).to_hex().to_string();
            manifest
                .files
                .insert((*file).to_owned(), FileEntry { len: bytes.len() as u64, blake3 });
        }
        self.disk.write_file(&scratch.path().join(MANIFEST), &manifest.to_json())?;
        self.publish(scratch, arrival)
    }

    /// Gives a whole directory its final name; the same checkpoint twice stays as it was, but for
    /// its score.
    pub(super) fn publish(
        &self,
        scratch: Scratch<'_>,
        arrival: Arrival<'_>,
    ) -> Result<Placement, CheckpointError> {
        let Arrival { name, digest, clash, score, imported } = arrival;
        let mut labels = Labels { score, imported, ..Labels::default() };
        if labels != Labels::default() {
            labels.write(&self.disk, scratch.path())?;
        }
        self.disk.sync_dir(scratch.path())?;
        let target = self.dir(name);
        let (guard, occupant) = self.occupant(name, digest)?;
        self.check_free(name)?;
        let conflict = |reason| CheckpointError::Conflict { path: target.clone(), reason };
        let mut aside = None;
        match (occupant, clash) {
            (Occupant::Nobody, _) => {}
            (Occupant::Same, _) => {
                self.edit_held(&guard, name, |there| {
                    there.score = labels.score.or(there.score.take());
                    // What the run has come to itself is its own, wherever it was first.
                    there.imported &= imported;
                    Ok(())
                })?;
                let placement = self.placement(&guard, name)?;
                drop(guard);
                scratch.discard()?;
                return Ok(placement);
            }
            (Occupant::Other(other), Clash::Refuse) => {
                return Err(conflict(format!(
                    "is another checkpoint already, with digest {other} instead of {digest}; \
                     choose another name, or delete that one first"
                )));
            }
            (Occupant::Stranger, Clash::Refuse) => {
                let reason = "is there and no checkpoint; choose another name, or move it away";
                return Err(conflict(reason.to_owned()));
            }
            // Damaged, or of a run whose limits were changed: out of the way, but not lost.
            (occupant, _) => {
                if matches!(occupant, Occupant::Damaged)
                    && let Ok(there) = Labels::try_read(&target)
                    && there != Labels::default()
                {
                    // Mended, it is what its users have pinned and tagged.
                    let score = labels.score.or(there.score.clone());
                    labels = Labels { score, imported, ..there };
                    labels.write(&self.disk, scratch.path())?;
                }
                let away = unique(&self.root, REPLACED, name.as_str());
                self.disk.rename(&target, &away)?;
                aside = Some(away);
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
        if let Some(away) = aside {
            tracing::warn!(
                checkpoint = %target.display(),
                before = %away.display(),
                "another checkpoint had this name; it is kept aside for a week, longer if pinned"
            );
        }
        self.placement(&guard, name)
    }

    /// Ends the publication of a checkpoint.
    fn placement(&self, guard: &Guard, name: &Name) -> Result<Placement, CheckpointError> {
        self.finish(guard, &[name]);
        Ok(Placement {
            dir: self.dir(name),
            best: self.best()?.is_some_and(|best| best.name == *name),
        })
    }

    /// Takes the right to change the store and says what has the name `name` then. Whatever is
    /// there is hashed before, and again if it was changed meanwhile.
    fn occupant(&self, name: &Name, digest: Digest) -> Result<(Guard, Occupant), CheckpointError> {
        let target = self.dir(name);
        loop {
            let before = Stamp::of_dir(&target);
            let occupant = match target.symlink_metadata() {
                Err(_) => Occupant::Nobody,
                Ok(there) if !there.is_dir() => Occupant::Stranger,
                Ok(_) => match read::load(&target) {
                    Ok(there) if there.manifest.digest == digest => Occupant::Same,
                    Ok(there) => Occupant::Other(there.manifest.digest),
                    Err(error) if error.is_absence() => {
                        let own = name.iteration().is_some() || target.join(MANIFEST).exists();
                        if own { Occupant::Damaged } else { Occupant::Stranger }
                    }
                    Err(error @ CheckpointError::Io { .. }) => return Err(error),
                    Err(_) => Occupant::Damaged,
                },
            };
            let guard = self.guard()?;
            if Stamp::of_dir(&target) == before {
                return Ok((guard, occupant));
            }
        }
    }

    /// Refuses a name that a checkpoint cannot get here: one that always selects another, one of
    /// the store's own files, and a tag.
    pub fn check_free(&self, name: &Name) -> Result<(), CheckpointError> {
        let text = name.as_str();
        let refuse = |why: String| {
            Err(CheckpointError::refused(format!("`{name}` {why}; choose another name")))
        };
        if [BEST, LATEST].contains(&text) {
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
    /// Whether a run may go on from it is for the run to say, see `base` of the crate `run`.
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
