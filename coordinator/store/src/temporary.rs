//! Names of what is being written, before it takes the place of a file or directory.
//!
//! They are names of our own, not of the crate `tempfile`: they say what is written and by which process of which machine, so that
//! what a killed one has left is known for that and removed, and nothing that another machine still writes.

use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

/// How long another machine may write nothing of what it has begun: what has not been touched for longer is nobody's any more.
const LONGEST_PAUSE: Duration = Duration::from_hours(1);

/// The name of the file or directory that is written before it takes the place of `path`. What killed processes
/// had begun to write there is removed.
pub fn beside(path: &Path) -> PathBuf {
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

/// Like [`beside`], of a directory that is to be made. Nothing is there: numbers of processes come again, and with them what one
/// that was killed had begun.
pub fn directory_beside(path: &Path) -> PathBuf {
    let temporary = beside(path);
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

/// Of a name that [`beside`] gave: that of the file to be replaced, and who was to replace it.
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

/// The directory in which `path` lies.
pub(crate) fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
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
        beside(&dir.path().join("run"));
        assert!(!whole_directory.exists());
        // Who writes a file anew removes what was begun of that file.
        let config = dir.path().join("config.toml");
        beside(&config);
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
        let file = std::fs::File::options().write(true).open(&old).expect("there");
        file.set_modified(long_ago).expect("own file");
        sweep(dir.path());
        assert_eq!([&new, &old, &own].map(|path| path.exists()), [true, false, false]);
        let name = new.file_name().and_then(|name| name.to_str()).expect("a name");
        assert_eq!(replaced(name), Some("sweep.toml"));
        let next = beside(&dir.path().join("sweep.toml"));
        let name = next.file_name().and_then(|name| name.to_str()).expect("a name");
        assert_eq!(replaced(name), Some("sweep.toml"), "{name}");
    }
}
