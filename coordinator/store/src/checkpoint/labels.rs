//! What users and runs say about a checkpoint after its commit.
//!
//! They lie beside the manifest, not in it: a manifest is never rewritten, and pins survive a deleted catalogue.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::Path;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::disk::Disk;
use super::error::CheckpointError;
use super::file_names::LABELS;
use super::name::Name;
use super::opening;

/// Most tags of a checkpoint.
pub const MAX_TAGS: usize = 32;
/// Longest file that is read (bytes).
const MAX_LEN: u64 = 1 << 20;

/// How good a checkpoint was found to be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// The smaller, the better.
    pub value: f64,
    /// What it was made from, by name.
    #[serde(default)]
    pub errors: BTreeMap<String, f64>,
    /// Episodes of the evaluation.
    pub episodes: u64,
    /// Control steps of an episode.
    pub steps: u64,
    /// Seed of the goals.
    pub seed: u64,
}

impl Score {
    /// Refuses numbers that are not finite: JSON has none, so they could be written but not read
    /// back.
    pub(super) fn check(&self, name: &Name) -> Result<(), CheckpointError> {
        let mut numbers = self.errors.values().chain([&self.value]);
        numbers.find(|number| !number.is_finite()).map_or(Ok(()), |wrong| {
            let reason = format!("the score of `{name}` holds {wrong}, which is no finite number");
            Err(CheckpointError::refused(reason))
        })
    }
}

/// What users and runs say about a checkpoint after its commit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Labels {
    /// Never removed before it is unpinned.
    #[serde(default)]
    pub pinned: bool,
    /// Names beside its own, each of at most one checkpoint of a store.
    #[serde(default)]
    pub tags: Vec<Name>,
    /// How good it was found to be.
    #[serde(default)]
    pub score: Option<Score>,
    /// Kept by every retention, because the run reached something with it.
    #[serde(default)]
    pub milestone: bool,
    /// It has come from outside under a name of the run's own. Retention neither counts it, or an
    /// upload could crowd out what the run has made, nor removes it.
    #[serde(default)]
    pub imported: bool,
}

impl Labels {
    /// Reads the labels of the checkpoint in `dir`. None there is none; damaged ones are reported
    /// through the log and count as pinned, so that nothing is removed by mistake.
    pub fn read(dir: &Path) -> Self {
        match Self::try_read(dir) {
            Ok(labels) => labels,
            Err(error) => {
                tracing::warn!(%error, "damaged labels; the checkpoint counts as pinned");
                Self::unreadable()
            }
        }
    }

    /// Reads the labels of the checkpoint in `dir`; no file means no labels.
    pub fn try_read(dir: &Path) -> Result<Self, CheckpointError> {
        let path = dir.join(LABELS);
        let file = match opening::file(&path) {
            Ok(file) => file,
            Err(error) if error.is_absence() => return Ok(Self::default()),
            Err(error) => return Err(error),
        };
        let mut bytes = Vec::new();
        file.take(MAX_LEN).read_to_end(&mut bytes).map_err(CheckpointError::io(&path, "read"))?;
        Self::parse(&bytes).map_err(|reason| CheckpointError::damaged(&path, reason))
    }

    /// Reads what labels are written as, or says why it is none.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        // Through an object: as a sequence `[]` would be labels too, and would unpin.
        serde_json::from_slice::<serde_json::Map<String, serde_json::Value>>(bytes)
            .and_then(|object| serde_json::from_value(object.into()))
            .map_err(|error| format!("not labels: {error}"))
    }

    /// What counts where labels cannot be read: pinned, so that nothing is removed by mistake.
    pub fn unreadable() -> Self {
        Self { pinned: true, ..Self::default() }
    }

    /// Replaces the labels of the checkpoint in `dir`: a reader finds the old or the new.
    pub(super) fn write(&self, disk: &Disk, dir: &Path) -> Result<(), CheckpointError> {
        let mut text = serde_json::to_vec_pretty(self).expect("labels have a JSON form");
        text.push(b'\n');
        disk.replace(&dir.join(LABELS), &text)
    }

    /// Whether it carries `tag`.
    pub fn has_tag(&self, tag: &str) -> bool {
        self.tags.iter().any(|there| there.as_str() == tag)
    }
}
