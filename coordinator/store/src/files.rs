//! Durable writing of small files: a reader finds the old content or the new, never a part.
//!
//! Temporary files have names of our own, not of the crate `tempfile`: they say what is written and by which process of which
//! machine, so that what a killed one has left is known for that and removed, and nothing that another machine still writes.

use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

use proto::{ExitCode, ExitError};

/// How long another machine may write nothing of what it has begun: what has not been touched for longer is nobody's any more.
const LONGEST_PAUSE: Duration = Duration::from_hours(1);

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
    let temporary = temporary(path);
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
    let temporary = temporary_directory(path);
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

/// The name of the file or directory that is written before it takes the place of `path`. What killed processes
/// had begun to write there is removed.
pub fn temporary(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    sweep_where(parent(path), |begun| begun == name);
    path.with_file_name(format!(".{name}.{}-{}.tmp", std::process::id(), numbering()))
}

/// Among which processes a number is one of a kind: those of this machine since it started, and of this container.
fn numbering() -> &'static str {
    static NUMBERING: OnceLock<String> = OnceLock::new();
    NUMBERING.get_or_init(|| {
        let start = std::fs::read("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let container = std::fs::read_link("/proc/self/ns/pid").unwrap_or_default();
        let hash = blake3::hash(&[&start, container.as_os_str().as_bytes()].concat());
        hash.to_hex()[..8].to_owned()
    })
}

/// Like [`temporary`], of a directory that is to be made. Nothing is there: numbers of processes come again, and with them what one
/// that was killed had begun.
pub fn temporary_directory(path: &Path) -> PathBuf {
    let temporary = temporary(path);
    // Mostly there is nothing; what cannot be removed is met by whoever makes the directory.
    let _ = std::fs::remove_dir_all(&temporary);
    temporary
}

/// Removes what killed processes of this user had begun to write in `directory` and below.
pub fn sweep(directory: &Path) {
    sweep_where(directory, |_| true);
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            sweep(&entry.path());
        }
    }
}

/// Removes from `directory` what killed processes of this user had begun to write in the place of files
/// and directories whose names `is_meant`. What stays is in nobody's way, so nothing here is an error.
fn sweep_where(directory: &Path, is_meant: impl Fn(&str) -> bool) {
    let uid = rustix::process::getuid().as_raw();
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some((begun, writer)) = name.to_str().and_then(parse_temporary) else { continue };
        // Of a link what it is itself.
        let Some(there) = entry.metadata().ok().filter(|there| there.uid() == uid) else {
            continue;
        };
        if !is_meant(begun) || writer.may_live(&entry.path()) {
            continue;
        }
        let _ = match there {
            there if there.is_file() => std::fs::remove_file(entry.path()),
            there if there.is_dir() => std::fs::remove_dir_all(entry.path()),
            _ => continue,
        };
    }
}

/// Of the name of a temporary file: that of the file that it was to replace.
pub fn replaced(name: &str) -> Option<&str> {
    parse_temporary(name).map(|(begun, _)| begun)
}

/// Who was to replace a file.
struct Writer<'a> {
    pid: u32,
    /// None if an older program wrote the name.
    numbering: Option<&'a str>,
}

impl Writer<'_> {
    /// Whether it may still write what is `there`.
    fn may_live(&self, there: &Path) -> bool {
        match self.numbering {
            Some(other) if other != numbering() => {
                let pause = touched(there).and_then(|touched| touched.elapsed().ok());
                pause.is_none_or(|pause| pause < LONGEST_PAUSE)
            }
            _ => Path::new("/proc").join(self.pid.to_string()).exists(),
        }
    }
}

/// When something of a file or of a directory was written last.
fn touched(path: &Path) -> Option<SystemTime> {
    let own = path.symlink_metadata().ok()?;
    let below = own.is_dir().then(|| std::fs::read_dir(path)).into_iter().flatten().flatten();
    let below = below.flatten().filter_map(|entry| touched(&entry.path()));
    own.modified().into_iter().chain(below).max()
}

/// Of a name that [`temporary`] gave: that of the file to be replaced, and who was to replace it.
fn parse_temporary(name: &str) -> Option<(&str, Writer<'_>)> {
    let (begun, writer) = name.strip_prefix('.')?.strip_suffix(".tmp")?.rsplit_once('.')?;
    let is_one = |numbering: &str| {
        numbering.len() == 8
            && numbering.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
    };
    let (pid, numbering) = match writer.split_once('-') {
        Some((pid, numbering)) => {
            (pid, Some(numbering).filter(|numbering| is_one(numbering))?.into())
        }
        None => (writer, None),
    };
    let pid = pid.parse().ok().filter(|_| pid.bytes().all(|byte| byte.is_ascii_digit()))?;
    (!begun.is_empty()).then_some((begun, Writer { pid, numbering }))
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
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

    /// A process that has ended.
    fn dead() -> u32 {
        let mut child = std::process::Command::new("true").spawn().expect("starts");
        child.wait().expect("own child");
        child.id()
    }

    #[test]
    fn what_a_killed_process_had_begun_to_write_goes_and_nothing_else() {
        let dir = tempfile::tempdir().expect("tempdir");
        let below = dir.path().join("checkpoints");
        std::fs::create_dir(&below).expect("mkdir");
        let (dead, alive) = (dead(), std::process::id());
        let left = [
            dir.path().join(format!(".config.toml.{dead}.tmp")),
            dir.path().join(format!(".metrics.csv.{dead}.tmp")),
            below.join(format!(".labels.json.{dead}.tmp")),
        ];
        let others = [
            dir.path().join(format!(".config.toml.{alive}.tmp")),
            dir.path().join(format!("config.toml.{dead}.tmp")),
            dir.path().join(format!(".config.toml.{dead}")),
            dir.path().join(".config.toml.old.tmp"),
            dir.path().join(".draft.2024-05-01.tmp"),
            dir.path().join(format!(".config.toml.+{dead}.tmp")),
            dir.path().join(format!(".{dead}.tmp")),
        ];
        for path in left.iter().chain(&others) {
            std::fs::write(path, "a part").expect("writable");
        }
        let whole_directory = dir.path().join(format!(".run.{dead}.tmp"));
        std::fs::create_dir(&whole_directory).expect("mkdir");
        std::fs::write(whole_directory.join("config.toml"), "a part").expect("writable");
        temporary(&dir.path().join("run"));
        assert!(!whole_directory.exists());
        // Who writes a file anew removes what was begun of that file.
        let config = dir.path().join("config.toml");
        temporary(&config);
        assert_eq!(left.each_ref().map(|path| path.exists()), [false, true, true]);
        sweep(dir.path());
        assert_eq!(left.each_ref().map(|path| path.exists()), [false; 3]);
        for path in &others {
            assert!(path.exists(), "{}", path.display());
        }
    }

    #[test]
    fn what_another_machine_writes_stays_while_it_does() {
        let dir = tempfile::tempdir().expect("tempdir");
        let [new, old] =
            [1, 2].map(|pid| dir.path().join(format!(".sweep.toml.{pid}-0badcafe.tmp")));
        let own = dir.path().join(format!(".sweep.toml.{}-{}.tmp", dead(), numbering()));
        for path in [&new, &old, &own] {
            std::fs::write(path, "a part").expect("writable");
        }
        let long_ago = SystemTime::now() - 2 * LONGEST_PAUSE;
        let file = File::options().write(true).open(&old).expect("there");
        file.set_modified(long_ago).expect("own file");
        sweep(dir.path());
        assert_eq!([&new, &old, &own].map(|path| path.exists()), [true, false, false]);
        let name = new.file_name().and_then(|name| name.to_str()).expect("a name");
        assert_eq!(replaced(name), Some("sweep.toml"));
        let next = temporary(&dir.path().join("sweep.toml"));
        let name = next.file_name().and_then(|name| name.to_str()).expect("a name");
        assert_eq!(replaced(name), Some("sweep.toml"), "{name}");
    }

    #[test]
    fn a_directory_is_made_whole_beside_nothing() {
        let dir = tempfile::tempdir().expect("tempdir");
        let place = dir.path().join("made");
        create_directory(&place, &[("a", b"1"), ("b", b"2")]).expect("made");
        assert_eq!(std::fs::read(place.join("b")).expect("there"), b"2");
        let again = create_directory(&place, &[("a", b"3")]).expect_err("it is there");
        assert_eq!(again.code, ExitCode::RunDirectory, "{again}");
        assert_eq!(std::fs::read(place.join("a")).expect("there"), b"1");
        let begun = temporary(&dir.path().join("next"));
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
