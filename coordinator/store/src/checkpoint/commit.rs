//! Committing a checkpoint: written whole beside the others, synced, and published by one rename.
//!
//! [`CheckpointStore::commit`] is the way of a run's own snapshots; imports and compositions publish by the
//! same last step.

use std::collections::BTreeMap;
use std::path::PathBuf;

use proto::config::Config;

use super::file_names::{CONFIG, FORMAT, MANIFEST, POLICY, ROBOT, STATE};
use super::guard::{Guard, REPLACED, Scratch, unique};
use super::labels::{Labels, Score};
use super::manifest::{FileEntry, Manifest};
use super::name::Name;
use super::read;
use super::store::{CheckpointStore, now};
use super::{CheckpointError, Snapshot, tensors};
use crate::stamp::Stamp;

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
    /// What it says about itself.
    pub(super) manifest: &'a Manifest,
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
    /// Another one, whole, and what is another than in the one that arrives.
    Other(String),
    /// A checkpoint that cannot be read, or that says to be the same with other tensors.
    Damaged,
    /// What never was a checkpoint.
    Stranger,
}

impl CheckpointStore {
    /// Commits a snapshot: every file is written and synced, the manifest last, then the directory
    /// is renamed to its final name and the rename is synced. Returns the checkpoint's directory.
    ///
    /// The same iteration committed twice is the same state; the one that is there stays, if its files
    /// are the same. A snapshot whose tensors have another digest than it says is refused.
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
        let damaged = |reason| CheckpointError::damaged(&self.dir(&name), reason);
        let parts = tensors::split(&snapshot.bytes).map_err(|reason| {
            damaged(format!("the learner's snapshot is no training state: {reason}"))
        })?;
        // A learner would refuse to go on from it, and until then older ones would have to go.
        if parts.digest != snapshot.digest {
            return Err(damaged(format!(
                "the learner's snapshot holds digest {}, and its learner says {}: it was damaged on \
                 its way",
                parts.digest, snapshot.digest
            )));
        }
        let config_toml = config.to_toml();
        let contents: [(&str, &[u8]); 4] = [
            (STATE, &parts.state),
            (POLICY, &parts.policy),
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
        self.write(&name, Clash::Replace, score, &contents, manifest)
    }

    /// Writes a new checkpoint and publishes it. `manifest` lists no files yet.
    pub(super) fn write(
        &self,
        name: &Name,
        clash: Clash,
        score: Option<Score>,
        contents: &[(&str, &[u8])],
        mut manifest: Manifest,
    ) -> Result<Placement, CheckpointError> {
        let scratch = Scratch::new(&self.disk, &self.root, name.as_str())?;
        for (file, bytes) in contents {
            self.disk.write_file(&scratch.path().join(file), bytes)?;
            let blake3 = blake3::hash(bytes).to_hex().to_string();
            manifest
                .files
                .insert((*file).to_owned(), FileEntry { len: bytes.len() as u64, blake3 });
        }
        self.disk.write_file(&scratch.path().join(MANIFEST), &manifest.to_json())?;
        let manifest = &manifest;
        self.publish(scratch, Arrival { name, manifest, clash, score, imported: false })
    }

    /// Gives a whole directory its final name; the same checkpoint twice stays as it was, but for
    /// its score.
    pub(super) fn publish(
        &self,
        scratch: Scratch<'_>,
        arrival: Arrival<'_>,
    ) -> Result<Placement, CheckpointError> {
        let Arrival { name, manifest, clash, score, imported } = arrival;
        let mut labels = Labels { score, imported, ..Labels::default() };
        if labels != Labels::default() {
            labels.write(&self.disk, scratch.path())?;
        }
        self.disk.sync_dir(scratch.path())?;
        let target = self.dir(name);
        let (guard, occupant) = self.occupant(name, manifest)?;
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
                    "is another checkpoint already, with {other}; choose another name, or delete \
                     that one first"
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
    fn occupant(
        &self,
        name: &Name,
        arriving: &Manifest,
    ) -> Result<(Guard, Occupant), CheckpointError> {
        let target = self.dir(name);
        loop {
            let before = Stamp::of_dir(&target);
            let occupant = match target.symlink_metadata() {
                Err(_) => Occupant::Nobody,
                Ok(there) if !there.is_dir() => Occupant::Stranger,
                Ok(_) => match read::load(&target) {
                    Ok(there) => compare(name, &there.manifest, arriving),
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
}

/// What the checkpoint that has the name is to the one that arrives, whose digest was found to be that of its tensors.
///
/// A run's iteration is told by its digest: budgets, for one, may differ after a resumption. What has that digest
/// and other tensors was damaged before its files were hashed. Under other names the same tensors may stand with
/// what other runs did.
fn compare(name: &Name, there: &Manifest, arriving: &Manifest) -> Occupant {
    if there.digest != arriving.digest {
        return Occupant::Other(format!("digest {} instead of {}", there.digest, arriving.digest));
    }
    let differs = |file: &&&str| there.files.get(**file) != arriving.files.get(**file);
    if name.iteration().is_some() {
        let other = [STATE, POLICY].iter().find(differs);
        return if other.is_some() { Occupant::Damaged } else { Occupant::Same };
    }
    match [CONFIG, ROBOT].iter().find(differs) {
        Some(file) => Occupant::Other(format!("the same tensors but another {file}")),
        None => Occupant::Same,
    }
}
