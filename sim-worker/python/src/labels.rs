//! What people and runs say of a checkpoint.

use std::path::Path;

use serde::Deserialize;

use crate::config::read;

/// Longest file (bytes).
const MAX_LABELS: u64 = 1 << 20;

#[derive(Deserialize, Default)]
pub(crate) struct Labels {
    #[serde(default)]
    pub(crate) tags: Vec<String>,
    #[serde(default)]
    pub(crate) score: Option<Score>,
    #[serde(default)]
    pub(crate) imported: bool,
}

#[derive(Deserialize)]
pub(crate) struct Score {
    pub(crate) value: f64,
}

impl Labels {
    /// Those of the checkpoint in a directory; none if they cannot be read.
    pub(crate) fn read(dir: &Path) -> Self {
        let bytes = read(&dir.join("labels.json"), MAX_LABELS).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }
}
