//! Files that must be this user's own, because what they say is believed: where a run listens, and
//! the token that is shown to it.

use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;

use crate::regular_files::{self, Links};

/// Rights of such a file.
pub const MODE: u32 = 0o600;
/// Longest such file that is read (bytes).
const MAX_LEN: u64 = 64 << 10;

/// What others may do with a file that is believed all the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Others {
    /// Read it.
    MayRead,
    /// Nothing.
    MayNothing,
}

/// Number of this user.
pub fn user() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// Refuses an open file that another user may have written.
pub fn check(file: &File, others: Others) -> io::Result<()> {
    let there = file.metadata()?;
    let refuse = |what: String| Err(io::Error::new(ErrorKind::PermissionDenied, what));
    let user = user();
    if there.uid() != user {
        return refuse(format!("it belongs to user {}, not to you (user {user})", there.uid()));
    }
    let forbidden = match others {
        Others::MayRead => 0o022,
        Others::MayNothing => 0o077,
    };
    let mode = there.mode() & 0o777;
    if mode & forbidden != 0 {
        let may = if mode & 0o022 == 0 { "read" } else { "write" };
        return refuse(format!("other users may {may} it (mode {mode:o}); `chmod 600` ends that"));
    }
    Ok(())
}

/// Reads the text of a file that must be this user's own.
pub fn read_text(path: &Path, others: Others) -> io::Result<String> {
    let file = regular_files::open_with(path, File::options().read(true), Links::Refuse)?;
    check(&file, others)?;
    let mut text = String::new();
    file.take(MAX_LEN).read_to_string(&mut text)?;
    Ok(text)
}

/// Puts a file there that is this user's own from its first moment, in the place of whatever was.
pub fn replace(path: &Path, content: &[u8]) -> io::Result<()> {
    let temporary = crate::temporary::beside(path);
    // Of a process of the same number that was killed.
    let _ = std::fs::remove_file(&temporary);
    let written = (|| {
        let mut file = File::options().write(true).create_new(true).mode(MODE).open(&temporary)?;
        file.write_all(content)?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)
    })();
    if written.is_err() {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&temporary);
    }
    written
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    use super::*;

    #[test]
    fn what_others_may_touch_is_not_believed() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("token");
        let link = dir.path().join("link");
        symlink(&path, &link).expect("a link");
        // Whatever was there, a way to elsewhere included, is replaced and not written through.
        let elsewhere = dir.path().join("elsewhere");
        std::fs::write(&elsewhere, "precious").expect("writable");
        symlink(&elsewhere, &path).expect("a link");
        replace(&path, b"secret").expect("writes");
        assert_eq!(std::fs::read_to_string(&elsewhere).expect("readable"), "precious");
        assert_eq!(path.metadata().expect("there").mode() & 0o777, MODE);
        assert_eq!(read_text(&path, Others::MayNothing).expect("own"), "secret");
        assert!(read_text(&link, Others::MayNothing).is_err(), "a link is not followed");
        for (mode, to_read, to_nothing) in [
            (0o600, true, true),
            (0o400, true, true),
            (0o640, true, false),
            (0o604, true, false),
            (0o620, false, false),
            (0o602, false, false),
            (0o666, false, false),
        ] {
            std::fs::set_permissions(&path, Permissions::from_mode(mode)).expect("own");
            assert_eq!(read_text(&path, Others::MayRead).is_ok(), to_read, "{mode:o}");
            assert_eq!(read_text(&path, Others::MayNothing).is_ok(), to_nothing, "{mode:o}");
        }
    }

    /// Only root can give a file away.
    #[test]
    fn what_belongs_to_another_user_is_not_believed() {
        if !rustix::process::geteuid().is_root() {
            return;
        }
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("token");
        replace(&path, b"secret").expect("writes");
        std::os::unix::fs::chown(&path, Some(65534), None).expect("root may");
        let error = read_text(&path, Others::MayRead).expect_err("foreign").to_string();
        assert!(error.contains("user 65534"), "{error}");
    }
}
