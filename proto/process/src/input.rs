//! What a child process reads: regular files, and of those only so much.
//!
//! The coordinator has looked at them, but whoever may write into a run directory can change them before a
//! child opens them. A named pipe would then be waited for until a deadline, and `/dev/zero` never ends.

use std::fs::File;
use std::io::{Error, ErrorKind, Read as _, Result};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

use rustix::fs::OFlags;

/// Longest text that is read: a configuration, a robot (bytes).
pub const TEXT: u64 = 1 << 20;
/// Longest training state that is read (bytes): more than the largest networks with the longest replay take.
pub const STATE: u64 = 2 << 40;

/// The content of the regular file at `path`, of `limit` bytes at most.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits().cast_signed();
    let file = File::options().read(true).custom_flags(flags).open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "it is no regular file"));
    }
    let too_long = || {
        let message = format!("it is longer than {limit} bytes, the most that is read");
        Error::new(ErrorKind::FileTooLarge, message)
    };
    // Before a byte of it is in memory.
    if metadata.len() > limit {
        return Err(too_long());
    }
    let mut bytes = Vec::new();
    let len = usize::try_from(metadata.len()).map_err(Error::other)?;
    bytes.try_reserve_exact(len).map_err(Error::other)?;
    file.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_long()) } else { Ok(bytes) }
}

/// The text in the regular file at `path`, of [`TEXT`] bytes at most.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read(path, TEXT)?)
        .map_err(|_| Error::new(ErrorKind::InvalidData, "it is no UTF-8 text"))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    #[test]
    fn only_regular_files_are_read_and_only_so_much_of_them() {
        let dir = std::env::temp_dir().join(format!("process-input-{}", std::process::id()));
        std::fs::create_dir(&dir).expect("a directory");
        let at = |name: &str| dir.join(name);
        mknodat(CWD, at("pipe"), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).expect("a pipe");
        symlink("/dev/zero", at("zero")).expect("a link");
        std::fs::write(at("file"), "text").expect("writable");
        File::create(at("sparse")).and_then(|file| file.set_len(1 << 40)).expect("sparse");
        std::fs::write(at("binary"), [0xff]).expect("writable");
        let refused: Vec<_> = ["pipe", "zero", "", "sparse", "binary", "nothing"]
            .map(|name| read_text(&at(name)).err().map(|error| error.kind()))
            .into();
        let text = read_text(&at("file"));
        let cut = read(&at("file"), 3).err().map(|error| error.kind());
        std::fs::remove_dir_all(&dir).expect("removable");
        let irregular = Some(ErrorKind::InvalidInput);
        let (long, binary, nothing) =
            (ErrorKind::FileTooLarge, ErrorKind::InvalidData, ErrorKind::NotFound);
        let expected = [irregular, irregular, irregular, Some(long), Some(binary), Some(nothing)];
        assert_eq!(refused, expected);
        assert_eq!(text.expect("readable"), "text");
        assert_eq!(cut, Some(long));
    }
}
