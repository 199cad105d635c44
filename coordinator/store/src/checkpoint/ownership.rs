//! Whether a checkpoint with a name of the run's own is the run's.
//!
//! Whoever imports or copies a checkpoint gives it such a name, too. The newest by name would then be what is
//! evaluated, served and shown as what the run has come to, while `octopus resume` passes it over (see
//! `resume_point` of the crate `run`).

use std::path::{Path, PathBuf};
use std::sync::Arc;

use proto::Digest;

use super::error::CheckpointError;
use super::labels::Labels;
use super::manifest::Manifest;
use super::store::CheckpointStore;
use crate::recorded::Recorded;

/// What tells a run's own checkpoints from others.
#[derive(Debug)]
pub struct Ownership {
    /// Whether the store belongs to a run; in any other all are alike.
    of_a_run: bool,
    /// What the run has come to; none where that cannot be read, or is lost.
    recorded: Option<Arc<Recorded>>,
}

impl Ownership {
    /// Of the run that the store belongs to, if it belongs to one.
    pub fn of(store: &CheckpointStore) -> Self {
        match store.run() {
            Some(run) => Self::of_run(store.recorded.read(&run).ok()),
            None => Self { of_a_run: false, recorded: None },
        }
    }

    /// Of a run that has recorded this, if it can be read.
    pub fn of_run(recorded: Option<Arc<Recorded>>) -> Self {
        let recorded = recorded.filter(|recorded| recorded.iterations() > 0);
        Self { of_a_run: true, recorded }
    }

    /// Whether the run has not come to the checkpoint in `dir`: its digest is another than the recorded
    /// one, or the metrics end before it. Where nothing is recorded, or its manifest cannot be read, what
    /// was imported is foreign.
    pub fn is_foreign(&self, dir: &Path, manifest: Option<(u64, Digest)>) -> bool {
        if !self.of_a_run {
            return false;
        }
        match (&self.recorded, manifest) {
            (Some(recorded), Some((iteration, digest))) if iteration > 0 => {
                recorded.digest_after(iteration) != Some(digest)
            }
            _ => Labels::read(dir).imported,
        }
    }

    /// Takes the directories of a [list](CheckpointStore::list) apart: the run's own, newest first, and those of such names
    /// that are not the run's. Nothing is hashed.
    pub fn part(&self, dirs: Vec<PathBuf>) -> [Vec<PathBuf>; 2] {
        let is_foreign = |dir: &PathBuf| {
            let manifest = Manifest::read(dir).ok();
            self.is_foreign(dir, manifest.map(|manifest| (manifest.iteration, manifest.digest)))
        };
        let (foreign, own) = dirs.into_iter().rev().partition(is_foreign);
        [own, foreign]
    }
}

impl CheckpointStore {
    /// Directories of the run's own checkpoints, newest first, and then of those of such names that are
    /// not the run's. Nothing is hashed.
    pub fn by_ownership(&self) -> Result<[Vec<PathBuf>; 2], CheckpointError> {
        // Before the metrics, which reach every one.
        let dirs = self.list()?;
        Ok(Ownership::of(self).part(dirs))
    }
}
