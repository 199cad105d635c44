//! The one place that writes to standard output: data, as tables a person reads or as JSON. Notes go
//! to standard error.
//!
//! * [`counted`], [`grouped`], [`size`], [`age`]: numbers and times as a person reads them;
//! * [`mod@table`]: tables that fit the terminal;
//! * [`quoted`]: words of commands that are shown to be copied;
//! * [`printable`](mod@printable): nothing that is shown tells a terminal what to do.

pub mod printable;
mod quoted;
pub mod table;
mod words;
mod wrap;

use std::io::{ErrorKind, Write as _};

use anyhow::Context as _;
use rustix::fs::{FileType, fstat};
use rustix::io::Errno;
use serde::Serialize;

pub use self::quoted::quoted;
pub use self::table::{COLUMNS, columns, table, table_within};
pub use self::words::{age, counted, grouped, size};
pub use self::wrap::{wrap, wrap_within};
use crate::printable::{printable, printable_json};

/// Writes a text with a line end.
pub fn line(text: &str) -> anyhow::Result<()> {
    write(format!("{}\n", printable(text)).as_bytes())
}

/// Writes a text with a line end to standard error, for a person.
pub fn note(text: &str) {
    // Nobody may be left to read it, and that is no reason to stop.
    let _ = writeln!(std::io::stderr(), "{}", printable(text));
}

/// Writes a value as indented JSON.
pub fn json(value: &impl Serialize) -> anyhow::Result<()> {
    write(&json_bytes(value)?)
}

/// Writes a value as JSON in one line.
pub fn json_line(value: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string(value).context("the result has no JSON form")?;
    write(format!("{}\n", printable_json(&text)).as_bytes())
}

/// What [`json`] writes.
pub fn json_bytes(value: &impl Serialize) -> anyhow::Result<Vec<u8>> {
    let mut text = serde_json::to_string_pretty(value).context("the result has no JSON form")?;
    text.push('\n');
    Ok(printable_json(&text).into_owned().into_bytes())
}

/// Writes bytes as they are. A reader that has seen enough, such as `head`, is no error, and neither is a
/// terminal that is closed.
pub fn write(bytes: &[u8]) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    written(stdout.write_all(bytes).and_then(|()| stdout.flush()))
}

/// What writing to standard output has come to, see [`write()`].
pub fn written(result: std::io::Result<()>) -> anyhow::Result<()> {
    match result {
        Err(error) if error.kind() != ErrorKind::BrokenPipe && !is_closed_terminal(&error) => {
            Err(error).context("standard output cannot be written")
        }
        _ => Ok(()),
    }
}

/// Whether standard output was a terminal, which answers EIO once it is closed. A file on a broken disk
/// does so, too, but is no character device.
fn is_closed_terminal(error: &std::io::Error) -> bool {
    let is_device = || {
        fstat(std::io::stdout())
            .is_ok_and(|stat| FileType::from_raw_mode(stat.st_mode) == FileType::CharacterDevice)
    };
    error.raw_os_error() == Some(Errno::IO.raw_os_error()) && is_device()
}

#[cfg(test)]
mod tests {
    use std::io::Error;

    use super::*;

    #[test]
    fn a_reader_that_has_seen_enough_is_no_error() {
        assert!(written(Ok(())).is_ok());
        assert!(written(Err(Error::from(ErrorKind::BrokenPipe))).is_ok());
        let full = written(Err(Errno::NOSPC.into())).expect_err("a full disk");
        assert!(full.to_string().starts_with("standard output cannot be written"), "{full}");
    }
}
