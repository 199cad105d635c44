//! Which checkpoints stay, and the removal of the others.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::entry::{Entry, Kind, Survey};
use super::error::CheckpointError;
use super::guard::{Guard, REMOVED, sweep, unique};
use super::labels::Labels;
use super::name::Name;
use super::ownership::Ownership;
use super::read::{self, looks_whole};
use super::reserved::BEST;
use super::store::CheckpointStore;
use crate::lock::RunLock;

/// Which of the run's own checkpoints stay. Pinned ones, milestones and tagged ones always do, and
/// so do all that are not the run's own: imported and composed ones, whatever their name, are for
/// users to remove.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Retention {
    /// The newest whole ones from which the run could go on; at least one stays.
    pub latest: usize,
    /// Those whose iteration is a multiple of this; 0 is none.
    pub every: u64,
    /// The one with the lowest score.
    pub best: bool,
}

impl Retention {
    /// Names of the run's own checkpoints that go; `counts` says which there are to go on from.
    pub fn doomed(self, survey: &Survey, counts: impl Fn(&Entry) -> bool) -> Vec<Name> {
        self.doomed_up_to(u64::MAX, survey, counts)
    }

    /// The same for a run that is at `iteration`: what lies beyond it was passed over, and neither counts nor goes.
    fn doomed_up_to(
        self,
        iteration: u64,
        survey: &Survey,
        counts: impl Fn(&Entry) -> bool,
    ) -> Vec<Name> {
        let own = || {
            let entries = survey.entries.iter();
            entries.filter(|entry| entry.name.iteration().is_some() && !entry.labels.imported)
        };
        let mut whole: Vec<u64> = own()
            .filter(|entry| entry.kind == Kind::Training && counts(entry))
            .filter_map(|entry| entry.name.iteration())
            .filter(|&of_entry| of_entry <= iteration)
            .collect();
        whole.sort_unstable_by(|a, b| b.cmp(a));
        whole.truncate(self.latest.max(1));
        // Whatever is newer than the oldest of these is one of them, or damaged and worth a look.
        let Some(&oldest_kept) = whole.last() else { return Vec::new() };
        let kept = |entry: &Entry| {
            let Labels { pinned, milestone, tags, .. } = &entry.labels;
            let periodic = self.every > 0 && entry.iteration.is_multiple_of(self.every);
            let tagged = tags.iter().any(|tag| self.best || tag.as_str() != BEST);
            periodic || *pinned || *milestone || tagged
        };
        let old = |name: &Name| name.iteration().is_some_and(|iteration| iteration < oldest_kept);
        let mut names: Vec<Name> = own()
            .filter(|entry| old(&entry.name) && !kept(entry))
            .map(|entry| entry.name.clone())
            .collect();
        let damaged = survey.damaged.iter().filter(|damaged| {
            let Labels { pinned, milestone, tags, imported, .. } = Labels::read(&damaged.dir);
            old(&damaged.name) && !(pinned || milestone || imported) && tags.is_empty()
        });
        names.extend(damaged.map(|damaged| damaged.name.clone()));
        names.sort();
        names
    }
}

impl CheckpointStore {
    /// Removes the run's own checkpoints that `retention` does not keep, and what killed processes
    /// have left; returns the names of the former.
    pub fn retain(&self, retention: &Retention) -> Result<Vec<Name>, CheckpointError> {
        self.retain_up_to(u64::MAX, retention)
    }

    /// The same for a run that is at `iteration`. Newer ones, which it could not go on from, do not push out what it commits.
    pub fn retain_up_to(
        &self,
        iteration: u64,
        retention: &Retention,
    ) -> Result<Vec<Name>, CheckpointError> {
        if !Guard::was_taken(&self.root) && self.survey()?.is_empty() {
            return Ok(Vec::new());
        }
        let guard = self.guard()?;
        // Before what is recorded is read: a checkpoint of a later iteration would be taken for foreign.
        let survey = self.survey()?;
        let doomed = retention.doomed_up_to(iteration, &survey, self.counts());
        for name in &doomed {
            self.put_away(&guard, name)?;
        }
        if !doomed.is_empty() {
            self.disk.sync_dir(&self.root)?;
        }
        let removed = sweep(&self.disk, &self.root, &guard)?;
        self.finish(&guard, &doomed.iter().collect::<Vec<_>>());
        drop(guard);
        removed.iter().try_for_each(|dir| self.disk.remove_dir(dir))?;
        Ok(doomed)
    }

    /// What [`Self::retain`] would remove.
    pub fn doomed(&self, retention: &Retention) -> Result<Vec<Name>, CheckpointError> {
        Ok(retention.doomed(&self.survey()?, self.counts()))
    }

    /// Tells of which checkpoints all files are there and whether the run could go on from them: what was
    /// copied into its directory is none that may push out its own.
    fn counts(&self) -> impl Fn(&Entry) -> bool {
        let ownership = Ownership::of(self);
        move |entry| {
            looks_whole(&entry.dir)
                && !ownership.is_foreign(&entry.dir, Some((entry.iteration, entry.digest)))
        }
    }

    /// Removes a checkpoint, damaged or not; refuses a pinned one, and the one from which the run
    /// goes on.
    pub fn delete(&self, name: &Name) -> Result<(), CheckpointError> {
        self.remove(name, false)
    }

    /// Like [`Self::delete`], also the one from which the run would go on, unless it is going on.
    pub fn delete_even_newest(&self, name: &Name) -> Result<(), CheckpointError> {
        self.remove(name, true)
    }

    fn remove(&self, name: &Name, even_newest: bool) -> Result<(), CheckpointError> {
        let dir = self.existing(name)?;
        // Before the guard is taken, because it hashes. Whatever comes meanwhile is newer, and what
        // goes meanwhile was not the newest.
        let mut needed = None;
        if let Some(run) = self.run()
            && self.newest_own()?.as_ref() == Some(name)
        {
            // What cannot be read is no reason to take it for free.
            let live = !matches!(RunLock::holder(&run.lock()), Ok(None));
            needed =
                (live || !even_newest).then(|| CheckpointError::Newest { path: dir.clone(), live });
        }
        let guard = self.guard()?;
        let survey = self.survey()?;
        let known = survey.entries.iter().map(|entry| &entry.name);
        if !known.chain(survey.damaged.iter().map(|entry| &entry.name)).any(|there| there == name) {
            return Err(CheckpointError::absent(&self.root, name));
        }
        if Labels::read(&dir).pinned {
            return Err(CheckpointError::Pinned { path: dir });
        }
        if let Some(error) = needed {
            return Err(error);
        }
        let away = self.put_away(&guard, name)?;
        self.disk.sync_dir(&self.root)?;
        self.finish(&guard, &[name]);
        drop(guard);
        self.disk.remove_dir(&away)
    }

    /// The newest whole one that the run has made itself; where it has none, that it was given.
    fn newest_own(&self) -> Result<Option<Name>, CheckpointError> {
        let mut own = self.survey()?.entries;
        own.retain(|entry| entry.name.iteration().is_some() && entry.kind == Kind::Training);
        own.reverse();
        // A stable sort: what was imported comes last, and the newest first among equals.
        own.sort_by_key(|entry| entry.labels.imported);
        Ok(own.into_iter().find(|entry| read::load(&entry.dir).is_ok()).map(|entry| entry.name))
    }

    /// Makes a checkpoint vanish at once: removing its files takes many steps, a rename one.
    fn put_away(&self, _: &Guard, name: &Name) -> Result<std::path::PathBuf, CheckpointError> {
        let away = unique(&self.root, REMOVED, name.as_str());
        self.disk.rename(&self.dir(name), &away)?;
        Ok(away)
    }
}
