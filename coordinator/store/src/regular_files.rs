//! Reading files that somebody else may have put there: only regular ones, and only so much of them.
//!
//! A named pipe in the place of a file would be waited for for ever, `/dev/zero` never ends, and a
//! device may do something when it is opened. So nothing is opened with waiting, what is open is
//! looked at before it is read, and what is read has a limit. Everything that a run directory holds
//! and a command line names is read through here.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;

use rustix::fs::OFlags;

/// Longest text that is read of those that people write: a configuration, a robot (bytes).
pub const TEXT: u64 = 1 << 20;
/// Longest record that is read of those that programs write (bytes): metrics of millions of iterations.
pub const RECORD: u64 = 4 << 30;

/// What becomes of a symbolic link in the last place of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Links {
    /// It is followed, and what it leads to must be a regular file.
    Follow,
    /// It is no regular file.
    Refuse,
}

/// Opens the regular file at `path` for reading; a link to one will do.
pub fn open(path: &Path) -> io::Result<File> {
    open_with(path, File::options().read(true), Links::Follow)
}

/// Opens the regular file at `path` as `options` say, without waiting for anything.
pub fn open_with(path: &Path, options: &mut OpenOptions, links: Links) -> io::Result<File> {
    let mut flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    if links == Links::Refuse {
        flags |= OFlags::NOFOLLOW;
    }
    let opened = options.custom_flags(flags.bits().cast_signed()).open(path);
    let file = opened.map_err(|error| {
        // A pipe without a reader, a directory, a link: better said by what they are.
        let there = match links {
            Links::Follow => path.metadata(),
            Links::Refuse => path.symlink_metadata(),
        };
        match there {
            Ok(there) if !there.is_file() => not_regular(there.file_type()),
            _ => error,
        }
    })?;
    let kind = file.metadata()?.file_type();
    if kind.is_file() { Ok(file) } else { Err(not_regular(kind)) }
}

/// The content of the regular file at `path`, of `limit` bytes at most.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    // Before a byte of it is in memory.
    if file.metadata()?.len() > limit {
        return Err(too_long(limit));
    }
    drain(file, limit)
}

/// The text in the regular file at `path`, of `limit` bytes at most.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    let text = String::from_utf8(read(path, limit)?);
    text.map_err(|_| io::Error::new(ErrorKind::InvalidData, "it is no UTF-8 text"))
}

/// Everything that `reader` has, of `limit` bytes at most.
pub fn drain(reader: impl Read, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    reader.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_long(limit)) } else { Ok(bytes) }
}

/// Refuses what is at `path` if that is something, but no regular file nor a link to one.
pub fn check(path: &Path) -> io::Result<()> {
    match path.metadata() {
        Ok(there) if !there.is_file() => Err(not_regular(there.file_type())),
        _ => Ok(()),
    }
}

/// Whether `path` itself, and no link there, is the open file.
pub fn is_at(file: &File, path: &Path) -> bool {
    let identity = |there: &std::fs::Metadata| (there.dev(), there.ino());
    let (open, there) = (file.metadata(), path.symlink_metadata());
    matches!((open, there), (Ok(open), Ok(there)) if identity(&open) == identity(&there))
}

/// What a thing that is no regular file is called.
pub fn kind(file_type: FileType) -> &'static str {
    match file_type {
        kind if kind.is_dir() => "a directory",
        kind if kind.is_symlink() => "a symbolic link",
        kind if kind.is_fifo() => "a pipe",
        kind if kind.is_socket() => "a socket",
        kind if kind.is_char_device() || kind.is_block_device() => "a device",
        kind if kind.is_file() => "a regular file",
        _ => "something unknown",
    }
}

fn not_regular(file_type: FileType) -> io::Error {
    let message = format!("it is {}, expected a regular file", kind(file_type));
    io::Error::new(ErrorKind::InvalidInput, message)
}

fn too_long(limit: u64) -> io::Error {
    let message = format!("it is longer than {limit} bytes, the most that is read");
    io::Error::new(ErrorKind::FileTooLarge, message)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    /// Reading with a writer that never comes, or from what never ends, would never return.
    #[test]
    fn what_is_no_regular_file_is_said_and_not_waited_for() {
        let dir = tempfile::tempdir().expect("tempdir");
        let at = |name: &str| dir.path().join(name);
        mknodat(CWD, at("pipe"), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).expect("a pipe");
        std::fs::create_dir(at("directory")).expect("a directory");
        let _socket = UnixListener::bind(at("socket")).expect("a socket");
        symlink("/dev/zero", at("zero")).expect("a link");
        std::fs::write(at("file"), "text").expect("writable");
        symlink(at("file"), at("link")).expect("a link");
        for (name, what) in [
            ("pipe", "a pipe"),
            ("directory", "a directory"),
            ("socket", "a socket"),
            ("zero", "a device"),
        ] {
            let said = |error: io::Error| {
                let error = error.to_string();
                assert_eq!(error, format!("it is {what}, expected a regular file"), "{name}");
            };
            said(read(&at(name), TEXT).expect_err(name));
            said(check(&at(name)).expect_err(name));
            for options in [File::options().write(true), File::options().read(true).write(true)] {
                said(open_with(&at(name), options, Links::Follow).expect_err(name));
            }
        }
        assert_eq!(read_text(&at("link"), TEXT).expect("readable"), "text");
        let mut options = File::options();
        let refused = open_with(&at("link"), options.read(true), Links::Refuse);
        assert!(refused.expect_err("a link").to_string().contains("a symbolic link"));
        check(&at("file")).expect("regular");
        check(&at("nothing")).expect("nothing is there");
        assert_eq!(read(&at("nothing"), 1).expect_err("nothing").kind(), ErrorKind::NotFound);
    }

    #[test]
    fn what_is_too_long_is_not_read() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("file");
        // Sparse: it takes no disk, but would take all memory.
        let file = File::create(&path).expect("writable");
        file.set_len(1 << 40).expect("sparse");
        let error = read(&path, RECORD).expect_err("too long").to_string();
        assert!(error.contains("4294967296 bytes"), "{error}");
        assert!(drain(io::repeat(0), 1000).is_err());
        assert_eq!(drain(&[7; 1000][..], 1000).expect("fits").len(), 1000);
    }
}
