//! `promised.jsonl`: the digests that iterations to come ended with when they were trained on before.
//!
//! A run that goes on from a checkpoint cuts the lines of later iterations off its metrics. Their
//! digests are written here first, so that a second kill does not lose what the first one left to
//! be compared. The file goes away when the run has passed the last of them. Its first line seals the
//! others: a changed digit would otherwise show as bits that are none of this machine's.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Context as _;
use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use store::recorded::Recorded;
use store::{files, regular_files};

/// A line of the file.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Promise {
    iteration: u64,
    digest: Digest,
}

/// The first line of the file; files of earlier versions have none.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Seal {
    lines: usize,
    /// Of everything after this line.
    blake3: String,
}

impl Seal {
    fn of(lines: &str) -> Self {
        let blake3 = blake3::hash(lines.as_bytes()).to_hex().to_string();
        Self { lines: lines.lines().count(), blake3 }
    }
}

/// A line of the file.
fn line(content: &impl Serialize) -> String {
    serde_json::to_string(content).expect("plain fields have a JSON form") + "\n"
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
        let text = match regular_files::read_text(&path, regular_files::RECORD) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(refuse(format!("cannot be read: {error}"))),
        };
        let (first, rest) = text.split_once('\n').unwrap_or((text.as_str(), ""));
        let (lines, before) = match serde_json::from_str::<Seal>(first) {
            Ok(seal) if seal != Seal::of(rest) => {
                return Err(refuse(format!(
                    "was changed since it was written: its first line is the seal of {} other \
                     lines, and not of these; put it back from a copy, or remove it",
                    seal.lines
                )));
            }
            Ok(_) => (rest, 1),
            Err(_) => (text.as_str(), 0),
        };
        let mut digests = BTreeMap::new();
        for (index, line) in lines.lines().enumerate() {
            let promise: Promise = serde_json::from_str(line)
                .map_err(|error| refuse(format!("line {}: {error}", index + before + 1)))?;
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
        let promise = |(&iteration, &digest)| line(&Promise { iteration, digest });
        let lines: String = self.digests.iter().map(promise).collect();
        files::replace(&self.path, (line(&Seal::of(&lines)) + &lines).as_bytes())
    }

    /// Refuses lines of the metrics whose digests are not the promised ones: every line was compared
    /// when it was written.
    pub fn agree(&self, recorded: &Recorded) -> Result<(), ExitError> {
        for (iteration, digest) in recorded.from(0) {
            if let Some(promised) = self.digests.get(&iteration)
                && *promised != digest
            {
                return Err(ExitError::new(
                    ExitCode::RunDirectory,
                    format!(
                        "{0}: line {1} has digest {digest}, {2} has {promised} for the same \
                         iteration: one of the files was changed; put it back from a copy, or \
                         remove {2}, and iterations that are trained on again are compared with \
                         {0} alone",
                        recorded.path().display(),
                        iteration + 1,
                        self.path.display()
                    ),
                ));
            }
        }
        Ok(())
    }

    /// Refuses a digest that is another than that of before.
    pub fn check(&self, iteration: u64, digest: Digest) -> Result<(), ExitError> {
        match self.digests.get(&iteration) {
            Some(before) if *before != digest => Err(ExitError::new(
                ExitCode::Failure,
                format!(
                    "iteration {iteration} was trained on again and ended with digest {digest}, \
                     before it was {before}: a file of the run was changed meanwhile (config.toml, \
                     robot.toml, a digest in metrics.jsonl), or this machine or this build is not \
                     the one of before; go on with what was there before, or remove {} to go on \
                     with other bits",
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
