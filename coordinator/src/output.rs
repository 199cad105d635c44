//! The one place that writes to standard output: data, as tables a person reads or as JSON.

mod table;

use std::io::{ErrorKind, Write as _};

use anyhow::Context as _;
use serde::Serialize;

pub use self::table::{COLUMNS, columns, table, table_within};
use crate::report::progress::grouped;

/// Writes a text with a line end.
pub fn line(text: &str) -> anyhow::Result<()> {
    write(format!("{text}\n").as_bytes())
}

/// Writes a value as indented JSON.
pub fn json(value: &impl Serialize) -> anyhow::Result<()> {
    write(&json_bytes(value)?)
}

/// What [`json`] writes.
pub fn json_bytes(value: &impl Serialize) -> anyhow::Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value).context("the result has no JSON form")?;
    text.push(b'\n');
    Ok(text)
}

/// Writes bytes as they are. A reader that has seen enough, such as `head`, is no error.
pub fn write(bytes: &[u8]) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(bytes).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("standard output cannot be written")
        }
        _ => Ok(()),
    }
}

/// A count and what is counted: `1 worker`, `1,200 workers`.
pub fn counted(count: u64, noun: &str) -> String {
    format!("{} {noun}{}", grouped(count), if count == 1 { "" } else { "s" })
}
