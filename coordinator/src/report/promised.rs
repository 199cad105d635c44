//! `promised.jsonl`: the digests that iterations to come ended with when they were trained on before.
//!
//! A run that goes on from a checkpoint cuts the lines of later iterations off its metrics. Their
//! digests are written here first, so that a second kill does not lose what the first one left to
//! be compared. The file goes away when the run has passed the last of them.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Context as _;
use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use serde::{Deserialize, Serialize};

use crate::{files, regular};

/// A line of the file.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Promise {
    iteration: u64,
    digest: Digest,
}

/// The file and what it holds.
#[derive(Debug)]
pub struct Promised {
    path: PathBuf,
    digests: BTreeMap<u64, Digest>,
}

impl Promised {
    /// Reads what earlier sessions of a run have left. A file that is damaged is an error: going on
    /// without it would leave the comparison out.
    pub fn read(run_dir: &RunDir) -> Result<Self, ExitError> {
        let path = run_dir.promised();
        let refuse = |what: String| {
            ExitError::new(
                ExitCode::RunDirectory,
                format!(
                    "{}: {what}; without the file the run goes on, and iterations that are trained \
                     on again are not compared with what they were before",
                    path.display()
                ),
            )
        };
        let text = match regular::read_text(&path, regular::RECORD) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(refuse(format!("cannot be read: {error}"))),
        };
        let mut digests = BTreeMap::new();
        for (index, line) in text.lines().enumerate() {
            let promise: Promise = serde_json::from_str(line)
                .map_err(|error| refuse(format!("line {}: {error}", index + 1)))?;
            digests.insert(promise.iteration, promise.digest);
        }
        Ok(Self { path, digests })
    }

    /// Adds digests, durably. Of an iteration that has one already the older counts: everything
    /// since was compared with it.
    pub fn add(
        &mut self,
        digests: impl IntoIterator<Item = (u64, Digest)>,
    ) -> Result<(), ExitError> {
        let before = self.digests.len();
        for (iteration, digest) in digests {
            self.digests.entry(iteration).or_insert(digest);
        }
        if self.digests.len() == before {
            return Ok(());
        }
        let mut text = Vec::new();
        for (&iteration, &digest) in &self.digests {
            serde_json::to_writer(&mut text, &Promise { iteration, digest })
                .expect("plain fields have a JSON form");
            text.push(b'\n');
        }
        files::replace(&self.path, &text)
    }

    /// Refuses a digest that is another than that of before.
    pub fn check(&self, iteration: u64, digest: Digest) -> Result<(), ExitError> {
        match self.digests.get(&iteration) {
            Some(before) if *before != digest => Err(ExitError::new(
                ExitCode::Failure,
                format!(
                    "iteration {iteration} was trained on again and ended with digest {digest}, \
                     before it was {before}: this machine, or this build, is not the one of before; \
                     go on with that one, or remove {} to go on with other bits",
                    self.path.display()
                ),
            )),
            _ => Ok(()),
        }
    }

    /// Whether nothing from `iteration` on is promised, but something before it.
    pub fn is_passed(&self, iteration: u64) -> bool {
        self.digests.last_key_value().is_some_and(|(last, _)| *last < iteration)
    }

    /// Forgets everything but the file, which whoever gets this has to [clear](Self::clear).
    pub fn take(&mut self) -> Self {
        Self { path: self.path.clone(), digests: std::mem::take(&mut self.digests) }
    }

    /// Forgets everything, the file included.
    pub fn clear(&mut self) -> anyhow::Result<()> {
        self.digests.clear();
        match std::fs::remove_file(&self.path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("{}: cannot be removed", self.path.display()))
            }
            _ => Ok(()),
        }
    }
}
