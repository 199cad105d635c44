//! `metrics.jsonl` and `evaluations.jsonl`: one JSON object a line, appended whole.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use proto::{ExitCode, ExitError};
use serde::Serialize;
use serde_json::Value;

use crate::{files, regular_files};

/// The open file.
#[derive(Debug)]
pub struct JsonLines {
    path: PathBuf,
    file: File,
}

impl JsonLines {
    /// Opens the file for appending after the lines of iterations before `keep`; the rest is cut
    /// off. Also returns the last kept line.
    pub fn open(path: &Path, keep: u64) -> anyhow::Result<(Self, Option<Value>)> {
        let kept = read(path)?
            .into_iter()
            .take_while(|(_, value)| value["iteration"].as_u64().is_some_and(|k| k < keep))
            .collect::<Vec<_>>();
        let text: String = kept.iter().flat_map(|(line, _)| [line.as_str(), "\n"]).collect();
        files::replace(path, text.as_bytes())?;
        let file = OpenOptions::new()
            .append(true)
            .open(path)
            .with_context(|| format!("{}: cannot be opened", path.display()))?;
        let last = kept.into_iter().next_back().map(|(_, value)| value);
        Ok((Self { path: path.to_owned(), file }, last))
    }

    /// Appends a line in one write, so that a reader never sees half of one.
    pub fn append(&mut self, line: &impl Serialize) -> anyhow::Result<()> {
        let mut text = serde_json::to_vec(line).context("a line of metrics has no JSON form")?;
        text.push(b'\n');
        self.file
            .write_all(&text)
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }

    /// Makes the lines durable.
    pub fn sync(&self) -> anyhow::Result<()> {
        self.file
            .sync_all()
            .with_context(|| format!("{}: cannot be made durable", self.path.display()))
    }
}

/// All whole lines of a file, with their parsed form; none if there is no file. Reading ends at
/// the first line that is no JSON, which is where a crash or a power cut spoiled the file.
pub fn read(path: &Path) -> anyhow::Result<Vec<(String, Value)>> {
    let bytes = match regular_files::read(path, regular_files::RECORD) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => {
            let message = format!("{}: cannot be read: {error}", path.display());
            return Err(ExitError::new(ExitCode::RunDirectory, message).into());
        }
    };
    Ok(parse(&bytes).map(|(line, value)| (line.to_owned(), value)).collect())
}

/// The whole lines that `bytes` begin with, up to the first that is no JSON.
pub(crate) fn parse(bytes: &[u8]) -> impl Iterator<Item = (&str, Value)> {
    bytes
        .split_inclusive(|&byte| byte == b'\n')
        .filter_map(|line| line.strip_suffix(b"\n"))
        .map_while(|line| Some((str::from_utf8(line).ok()?, serde_json::from_slice(line).ok()?)))
}
