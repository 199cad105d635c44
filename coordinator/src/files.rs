//! Durable writing of small files: a reader finds the old content or the new, never a part.

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use proto::{ExitCode, ExitError};

/// Replaces the content of `path`: temporary file beside it, fsync, rename, fsync of the directory.
pub fn replace(path: &Path, content: &[u8]) -> Result<(), ExitError> {
    replace_io(path, content).map_err(|error| failure(ExitCode::RunDirectory, path, &error))
}

/// Like [`replace`], for a file that the user named on the command line; one that is no regular
/// file, such as `/dev/stdout`, is written to as it is.
pub fn replace_output(path: &Path, content: &[u8]) -> Result<(), ExitError> {
    let special = std::fs::metadata(path).is_ok_and(|there| !there.is_file());
    let written = if special {
        File::options().write(true).open(path).and_then(|mut file| file.write_all(content))
    } else {
        replace_io(path, content)
    };
    written.map_err(|error| failure(ExitCode::Failure, path, &error))
}

fn failure(code: ExitCode, path: &Path, error: &std::io::Error) -> ExitError {
    ExitError::new(code, format!("{}: cannot be written: {error}", path.display()))
}

/// [`replace`], with the system's own error for who says himself what failed.
pub(crate) fn replace_io(path: &Path, content: &[u8]) -> std::io::Result<()> {
    let temporary = temporary(path);
    let written = (|| {
        let mut file = File::create(&temporary)?;
        file.write_all(content)?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)?;
        File::open(parent(path))?.sync_all()
    })();
    if written.is_err() {
        // The first error is the one to report; the temporary file may not even exist.
        let _ = std::fs::remove_file(&temporary);
    }
    written
}

/// The name of the file that is written before it takes the place of `path`.
pub fn temporary(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.{}.tmp", std::process::id()))
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use std::io::ErrorKind;

    use super::*;

    #[test]
    fn a_failure_keeps_the_kind_that_the_system_gave_it() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("gone").join("labels.json");
        assert_eq!(replace_io(&path, b"{}").expect_err("no directory").kind(), ErrorKind::NotFound);
        let said = replace(&path, b"{}").expect_err("no directory").to_string();
        assert_eq!(said.matches("labels.json").count(), 1, "{said}");
    }
}
