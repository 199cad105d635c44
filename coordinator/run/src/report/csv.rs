//! `metrics.csv`: the numbers of `metrics.jsonl` as a table.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use proto::{ExitCode, ExitError};
use serde_json::Value;
use store::{files, jsonl, regular_files};

use super::line::Line;

/// The open file.
#[derive(Debug)]
pub struct CsvTable {
    path: PathBuf,
    file: File,
    /// The first line, if there is one.
    header: Option<String>,
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
        let file = replaced(path, &text)?;
        let header = header.map(|header| header.trim_end().to_owned());
        Ok(Self { path: path.to_owned(), file, header })
    }

    /// Appends a row, before the first one the header.
    pub fn append(&mut self, line: &Line) -> anyhow::Result<()> {
        let cells = line.cells();
        let names: Vec<_> = cells.iter().map(|(name, _)| name.as_ref()).collect();
        let header = names.join(",");
        if self.header.as_ref() != Some(&header) {
            self.begin(header, line.iteration)?;
        }
        let values: Vec<_> = cells.iter().map(|(_, cell)| cell.to_string()).collect();
        let text = values.join(",") + "\n";
        self.file
            .write_all(text.as_bytes())
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }

    /// Begins the table with these columns. Where another program has written others, its rows get these, from the lines
    /// of `metrics.jsonl` before the iteration `until`.
    fn begin(&mut self, header: String, until: u64) -> anyhow::Result<()> {
        let mut text = format!("{header}\n");
        if self.header.is_some() {
            for (_, line) in jsonl::read(&self.path.with_extension("jsonl"))? {
                if line["iteration"].as_u64().is_some_and(|iteration| iteration < until) {
                    let values: Vec<_> = header.split(',').map(|name| cell(&line, name)).collect();
                    text += &(values.join(",") + "\n");
                }
            }
        }
        self.file = replaced(&self.path, &text)?;
        self.header = Some(header);
        Ok(())
    }

    /// Makes the rows durable.
    pub fn sync(&self) -> anyhow::Result<()> {
        self.file
            .sync_all()
            .with_context(|| format!("{}: cannot be made durable", self.path.display()))
    }
}

/// The file, with this text, for appending.
fn replaced(path: &Path, text: &str) -> anyhow::Result<File> {
    files::replace(path, text.as_bytes())?;
    let file = OpenOptions::new().append(true).open(path);
    file.with_context(|| format!("{}: cannot be opened", path.display()))
}

/// What a line of `metrics.jsonl` holds under a dotted name; nothing where it has no such number.
fn cell(line: &Value, name: &str) -> String {
    let found = name.split('.').try_fold(line, |value, part| match value {
        Value::Array(items) => items.get(part.parse::<usize>().ok()?),
        value => value.get(part),
    });
    match found {
        Some(Value::String(text)) => text.clone(),
        Some(Value::Number(number)) => number.to_string(),
        _ => String::new(),
    }
}
