//! Room for uploads: whatever clients send, a run can still write its checkpoints, and others their
//! files.

use std::path::Path;

use axum::http::StatusCode;
use store::files;

use super::problem::Problem;

/// Refuses an upload that needs `needed` more bytes on the disk of `root` if fewer than `reserve`
/// would be left there.
pub(super) fn check(root: &Path, needed: u64, reserve: u64) -> Result<(), Problem> {
    // The store may be still to be made.
    let there = root.ancestors().find(|dir| dir.is_dir()).unwrap_or(Path::new("."));
    let free = files::free_space(there).map_err(|error| Problem::internal(&error))?;
    if needed.saturating_add(reserve) <= free {
        return Ok(());
    }
    Err(full(format!(
        "the upload needs {needed} bytes more, and of the {free} bytes that are free on this disk \
         {reserve} stay free; delete what is not needed, and try again"
    )))
}

/// Refuses an upload when those that are there take `taken` of at most `most` bytes.
pub(super) fn check_total(taken: u64, most: u64) -> Result<(), Problem> {
    if taken < most {
        return Ok(());
    }
    Err(full(format!(
        "uploaded checkpoints take {taken} bytes here, and {most} is the most beside a live run; \
         delete some, and try again"
    )))
}

fn full(message: String) -> Problem {
    Problem::new(StatusCode::INSUFFICIENT_STORAGE, message)
}
