//! The runs that lie in a directory.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use proto::run_dir::RunDir;

use crate::checkpoint::MANIFEST;

/// Whether `path` is a run directory among others. What is hidden is none: stores hide what they are still writing. A checkpoint has a
/// configuration, too, and is none.
pub fn is_run(path: &Path) -> bool {
    let is_shown = |name: &OsStr| !name.as_encoded_bytes().starts_with(b".");
    path.file_name().is_some_and(is_shown)
        && RunDir::new(path).config().is_file()
        && !path.join(MANIFEST).exists()
}

/// The run directories in `dir`, by name.
pub fn runs_in(dir: &Path) -> std::io::Result<Vec<RunDir>> {
    let entries = std::fs::read_dir(dir)?.flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.retain(|path| is_run(path));
    paths.sort();
    Ok(paths.into_iter().map(RunDir::new).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neither_what_is_hidden_nor_a_checkpoint_is_a_run() {
        let dir = tempfile::tempdir().expect("tempdir");
        // The third as an import leaves it that was killed.
        for name in ["b", "a", ".writing-import-1-0-0", "iteration-00000001"] {
            let run = RunDir::new(dir.path().join(name));
            std::fs::create_dir(run.path()).expect("made");
            std::fs::write(run.config(), "").expect("written");
        }
        std::fs::write(dir.path().join("iteration-00000001").join(MANIFEST), "").expect("written");
        std::fs::create_dir(dir.path().join("notes")).expect("made");
        let runs = ["a", "b"].map(|name| RunDir::new(dir.path().join(name)));
        assert_eq!(runs_in(dir.path()).expect("readable"), runs);
        assert_eq!(runs_in(&dir.path().join("a")).expect("readable"), []);
        assert!(runs_in(&dir.path().join("none")).is_err());
    }
}
