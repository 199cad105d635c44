//! Durable writing of small files: a reader finds the old content or the new, never a part.

use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::Path;

use proto::{ExitCode, ExitError};

use crate::temporary::{self, parent};

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

/// Whether [`replace_output`] can make a file at `path`; nothing stays of the trial.
pub(crate) fn try_place(path: &Path) -> std::io::Result<()> {
    let temporary = temporary::beside(path);
    match File::create_new(&temporary) {
        // Of a process of the same number that was killed: the place takes files.
        Err(error) if error.kind() == ErrorKind::AlreadyExists => return Ok(()),
        made => made?,
    };
    match std::fs::remove_file(&temporary) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Whether files can be made in `directory`, or in what is there above it where it is still to be made.
pub fn try_directory(directory: &Path) -> std::io::Result<()> {
    // So that a relative one ends here.
    let directory = Path::new(".").join(directory);
    match directory.ancestors().find(|above| above.is_dir()) {
        Some(there) => try_place(&there.join("trial")),
        None => Ok(()),
    }
}

fn failure(code: ExitCode, path: &Path, error: &std::io::Error) -> ExitError {
    ExitError::new(code, format!("{}: cannot be written: {error}", path.display()))
}

/// [`replace`], with the system's own error for who says himself what failed.
pub(crate) fn replace_io(path: &Path, content: &[u8]) -> std::io::Result<()> {
    let temporary = temporary::beside(path);
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

/// Makes the directory `path` with these files, whole or not at all: a temporary directory beside it, fsync, rename.
///
/// # Errors
/// If something is there already ([`ExitCode::RunDirectory`]), or it cannot be written.
pub fn create_directory(path: &Path, files: &[(&str, &[u8])]) -> Result<(), ExitError> {
    let is_there = || {
        let message = format!("{}: is there already; name another place", path.display());
        ExitError::new(ExitCode::RunDirectory, message)
    };
    let failed = |error: std::io::Error| failure(ExitCode::Failure, path, &error);
    let temporary = temporary::directory_beside(path);
    std::fs::create_dir(&temporary).map_err(failed)?;
    let written = (|| {
        for (name, content) in files {
            let mut file = File::create_new(temporary.join(name))?;
            file.write_all(content)?;
            file.sync_all()?;
        }
        File::open(&temporary)?.sync_all()?;
        // An empty directory would be replaced otherwise.
        let flags = rustix::fs::RenameFlags::NOREPLACE;
        rustix::fs::renameat_with(rustix::fs::CWD, &temporary, rustix::fs::CWD, path, flags)?;
        File::open(parent(path))?.sync_all()
    })();
    if written.is_err() {
        // The first error is the one to report.
        let _ = std::fs::remove_dir_all(&temporary);
    }
    written.map_err(|error: std::io::Error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => is_there(),
        _ => failed(error),
    })
}

/// Bytes that this user may still write where `path` lies.
pub fn free_space(path: &Path) -> std::io::Result<u64> {
    let space = rustix::fs::statvfs(path)?;
    Ok(space.f_bavail * space.f_frsize)
}

#[cfg(test)]
mod tests {
    use std::io::ErrorKind;

    use super::*;

    #[test]
    fn a_directory_is_made_whole_beside_nothing() {
        let dir = tempfile::tempdir().expect("tempdir");
        let place = dir.path().join("made");
        create_directory(&place, &[("a", b"1"), ("b", b"2")]).expect("made");
        assert_eq!(std::fs::read(place.join("b")).expect("there"), b"2");
        let again = create_directory(&place, &[("a", b"3")]).expect_err("it is there");
        assert_eq!(again.code, ExitCode::RunDirectory, "{again}");
        assert_eq!(std::fs::read(place.join("a")).expect("there"), b"1");
        let begun = temporary::beside(&dir.path().join("next"));
        std::fs::create_dir(&begun).expect("made");
        std::fs::write(begun.join("c"), "a part").expect("writable");
        let next = dir.path().join("next");
        create_directory(&next, &[("a", b"1")]).expect("who began it had this number before");
        assert!(!next.join("c").exists());
        std::fs::remove_dir_all(&next).expect("removed");
        let empty = dir.path().join("empty");
        std::fs::create_dir(&empty).expect("made");
        assert!(create_directory(&empty, &[("a", b"1")]).is_err(), "it is somebody's");
        let twice = dir.path().join("twice");
        assert!(create_directory(&twice, &[("a", b"1"), ("a", b"2")]).is_err());
        assert!(create_directory(&dir.path().join("none/made"), &[]).is_err());
        let mut left: Vec<_> = std::fs::read_dir(dir.path()).expect("read").flatten().collect();
        left.sort_by_key(std::fs::DirEntry::file_name);
        let left: Vec<_> = left.iter().map(std::fs::DirEntry::file_name).collect();
        assert_eq!(left, ["empty", "made"]);
    }

    #[test]
    fn a_failure_keeps_the_kind_that_the_system_gave_it() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("gone").join("labels.json");
        assert_eq!(replace_io(&path, b"{}").expect_err("no directory").kind(), ErrorKind::NotFound);
        let said = replace(&path, b"{}").expect_err("no directory").to_string();
        assert_eq!(said.matches("labels.json").count(), 1, "{said}");
    }
}
