//! `metrics.csv`: the numbers of `metrics.jsonl` as a table.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use proto::{ExitCode, ExitError};
use store::{files, regular_files};

use super::line::Line;

/// The open file.
#[derive(Debug)]
pub struct CsvTable {
    path: PathBuf,
    file: File,
    has_header: bool,
}

impl CsvTable {
    /// Opens the file for appending after the rows of iterations before `keep`; the rest is cut
    /// off.
    pub fn open(path: &Path, keep: u64) -> anyhow::Result<Self> {
        let old = match regular_files::read(path, regular_files::RECORD) {
            // What a power cut has spoiled is no row and ends the kept ones.
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => {
                let message = format!("{}: cannot be read: {error}", path.display());
                return Err(ExitError::new(ExitCode::RunDirectory, message).into());
            }
        };
        let mut rows = old.split_inclusive('\n').filter(|row| row.ends_with('\n'));
        let header = rows.next().filter(|_| keep > 0);
        let kept = rows.take_while(|row| {
            let iteration = row.split(',').next().and_then(|cell| cell.parse::<u64>().ok());
            iteration.is_some_and(|k| k < keep)
        });
        let text: String = header.into_iter().chain(kept).collect();
        files::replace(path, text.as_bytes())?;
        let file = OpenOptions::new()
            .append(true)
            .open(path)
            .with_context(|| format!("{}: cannot be opened", path.display()))?;
        Ok(Self { path: path.to_owned(), file, has_header: !text.is_empty() })
    }

    /// Appends a row, before the first one the header.
    pub fn append(&mut self, line: &Line) -> anyhow::Result<()> {
        let cells = line.cells();
        let mut text = String::new();
        if !self.has_header {
            let names: Vec<_> = cells.iter().map(|(name, _)| name.as_ref()).collect();
            text = names.join(",") + "\n";
            self.has_header = true;
        }
        let values: Vec<_> = cells.iter().map(|(_, cell)| cell.to_string()).collect();
        text += &values.join(",");
        text.push('\n');
        self.file
            .write_all(text.as_bytes())
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }

    /// Makes the rows durable.
    pub fn sync(&self) -> anyhow::Result<()> {
        self.file
            .sync_all()
            .with_context(|| format!("{}: cannot be made durable", self.path.display()))
    }
}
