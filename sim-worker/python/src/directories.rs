//! The directories of a store of checkpoints.

use std::path::{Path, PathBuf};

/// All of them. A link is none: what it leads to is not the store's.
pub(crate) fn directories(store: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(store).into_iter().flatten().flatten();
    entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        .map(|entry| entry.path())
}

pub(crate) fn name(dir: &Path) -> &str {
    dir.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

/// The iteration in the name of a run's own checkpoint.
pub(crate) fn iteration(dir: &Path) -> Option<u64> {
    name(dir).strip_prefix("iteration-")?.parse().ok()
}
