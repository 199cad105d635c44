//! Pins, tags, scores and milestones.

use super::entry::{Entry, Survey};
use super::error::CheckpointError;
use super::guard::Guard;
use super::labels::{Labels, MAX_TAGS, Score};
use super::manifest::Manifest;
use super::name::Name;
use super::ownership::Ownership;
use super::reserved::{BEST, LATEST};
use super::store::CheckpointStore;

impl CheckpointStore {
    /// Pins a checkpoint, so that nothing removes it, or lets it go.
    pub fn pin(&self, name: &Name, pinned: bool) -> Result<(), CheckpointError> {
        self.edit(name, |labels| {
            labels.pinned = pinned;
            Ok(())
        })
    }

    /// Marks a checkpoint as one with which the run reached something; retention keeps it.
    pub fn set_milestone(&self, name: &Name, milestone: bool) -> Result<(), CheckpointError> {
        self.edit(name, |labels| {
            labels.milestone = milestone;
            Ok(())
        })
    }

    /// Gives a checkpoint a tag, and takes it from the one that had it.
    ///
    /// Refused are `best` and `latest`, which move by themselves, a number, which selects an
    /// iteration, and the name of a checkpoint.
    pub fn tag(&self, name: &Name, tag: &str) -> Result<(), CheckpointError> {
        let tag: Name = tag.parse()?;
        if [BEST, LATEST].contains(&tag.as_str()) {
            let reason = format!("the tag `{tag}` moves by itself; choose another");
            return Err(CheckpointError::refused(reason));
        }
        if tag.as_str().bytes().all(|byte| byte.is_ascii_digit()) {
            let reason = format!("the tag `{tag}` would look like an iteration; choose another");
            return Err(CheckpointError::refused(reason));
        }
        self.existing(name)?;
        let guard = self.guard()?;
        let survey = self.survey()?;
        if tag.iteration().is_some() || self.existing(&tag).is_ok() {
            let reason = format!("`{tag}` is the name of a checkpoint; choose another tag");
            return Err(CheckpointError::refused(reason));
        }
        // On the new one first: killed in between, both have it, and both are kept.
        self.edit_held(&guard, name, |labels| {
            if labels.has_tag(tag.as_str()) {
                return Ok(());
            }
            if labels.tags.len() >= MAX_TAGS {
                let reason = format!("`{name}` has {MAX_TAGS} tags already; untag it first");
                return Err(CheckpointError::refused(reason));
            }
            labels.tags.push(tag.clone());
            labels.tags.sort();
            Ok(())
        })?;
        self.take_tag(&survey, &tag, Some(name))?;
        self.finish(&guard, &[name]);
        Ok(())
    }

    /// Takes a tag from a checkpoint.
    pub fn untag(&self, name: &Name, tag: &str) -> Result<(), CheckpointError> {
        let tag: Name = tag.parse()?;
        if tag.as_str() == BEST {
            return Err(CheckpointError::refused(format!("the tag `{BEST}` follows the scores")));
        }
        self.edit(name, |labels| {
            let before = labels.tags.len();
            labels.tags.retain(|there| *there != tag);
            if labels.tags.len() == before {
                let what = format!("`{name}` has no tag `{tag}`");
                return Err(CheckpointError::NotFound { path: self.root.clone(), what });
            }
            Ok(())
        })
    }

    /// Records how good a checkpoint was found to be. If it is the lowest score of the run's own
    /// checkpoints the tag `best` moves to it; returns whether it has that tag now.
    pub fn record_score(&self, name: &Name, score: Score) -> Result<bool, CheckpointError> {
        score.check(name)?;
        let guard = self.guard()?;
        self.edit_held(&guard, name, |labels| {
            labels.score = Some(score);
            Ok(())
        })?;
        self.settle_best(&guard)?;
        self.finish(&guard, &[name]);
        Ok(self.best()?.is_some_and(|best| best.name == *name))
    }

    /// The run's own checkpoint with the lowest score; of equal ones the earliest.
    pub fn best(&self) -> Result<Option<Entry>, CheckpointError> {
        let entries = self.entries()?;
        Ok(best_of(entries, &Ownership::of(self)))
    }

    /// Puts the tag `best` where the scores say and nowhere else.
    pub(super) fn settle_best(&self, _: &Guard) -> Result<(), CheckpointError> {
        let survey = self.survey()?;
        let best = best_of(survey.entries.clone(), &Ownership::of(self));
        let tag: Name = BEST.parse()?;
        if let Some(best) = &best
            && !best.labels.has_tag(BEST)
        {
            let mut labels = best.labels.clone();
            labels.tags.push(tag.clone());
            labels.tags.sort();
            labels.write(&self.disk, &best.dir)?;
        }
        self.take_tag(&survey, &tag, best.as_ref().map(|best| &best.name))
    }

    /// Takes a tag from everybody but `keeper`.
    fn take_tag(
        &self,
        survey: &Survey,
        tag: &Name,
        keeper: Option<&Name>,
    ) -> Result<(), CheckpointError> {
        for entry in &survey.entries {
            if Some(&entry.name) != keeper && entry.labels.has_tag(tag.as_str()) {
                let mut labels = entry.labels.clone();
                labels.tags.retain(|there| there != tag);
                labels.write(&self.disk, &entry.dir)?;
            }
        }
        Ok(())
    }

    /// Changes the labels of a checkpoint.
    fn edit(
        &self,
        name: &Name,
        change: impl FnOnce(&mut Labels) -> Result<(), CheckpointError>,
    ) -> Result<(), CheckpointError> {
        // Where there is none, not even a lock is made.
        self.existing(name)?;
        let guard = self.guard()?;
        self.edit_held(&guard, name, change)?;
        self.finish(&guard, &[name]);
        Ok(())
    }

    pub(super) fn edit_held(
        &self,
        _: &Guard,
        name: &Name,
        change: impl FnOnce(&mut Labels) -> Result<(), CheckpointError>,
    ) -> Result<(), CheckpointError> {
        let dir = self.existing(name)?;
        // A damaged checkpoint may be unpinned too, or it could never be deleted; but a directory
        // that is none stays as it is.
        if name.iteration().is_none()
            && let Err(error) = Manifest::read(&dir)
            && error.is_absence()
        {
            return Err(error);
        }
        let before = Labels::read(&dir);
        let mut after = before.clone();
        change(&mut after)?;
        if after == before && Labels::try_read(&dir).is_ok() {
            return Ok(());
        }
        after.write(&self.disk, &dir)
    }
}

/// What was copied into a store brings its score, and is not what the run has come to.
fn best_of(entries: Vec<Entry>, ownership: &Ownership) -> Option<Entry> {
    let score = |entry: &Entry| entry.labels.score.as_ref().map(|score| score.value);
    entries
        .into_iter()
        .filter(|entry| {
            let manifest = Some((entry.iteration, entry.digest));
            entry.name.iteration().is_some() && !ownership.is_foreign(&entry.dir, manifest)
        })
        .filter_map(|entry| Some((score(&entry).filter(|value| value.is_finite())?, entry)))
        .min_by(|(a, left), (b, right)| a.total_cmp(b).then(left.iteration.cmp(&right.iteration)))
        .map(|(_, entry)| entry)
}
