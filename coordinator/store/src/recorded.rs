//! What `metrics.jsonl` says of the iterations that a run has done: the digest that each ended with.
//!
//! Only digests are taken from the file, and only to be compared: a checkpoint is a place to go on from
//! if it has the digest that its last iteration ended with. Other numbers are for people; a changed one
//! changes nothing that is learned, and nobody notices it.

use std::path::PathBuf;

use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use serde_json::Value;

use crate::jsonl;

/// The digests of a run's iterations, from the first on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    path: PathBuf,
    digests: Vec<Digest>,
}

impl Recorded {
    /// Reads the lines of a run, which count 0, 1, 2, …; none if it has no file. They end at the first
    /// that is no JSON, where a crash or a power cut spoiled the file.
    pub fn read(run_dir: &RunDir) -> Result<Self, ExitError> {
        let path = run_dir.metrics_jsonl();
        let unreadable =
            |error: anyhow::Error| ExitError::new(ExitCode::RunDirectory, format!("{error:#}"));
        let lines = jsonl::read(&path).map_err(unreadable)?;
        let mut digests = Vec::with_capacity(lines.len());
        for (index, (_, line)) in lines.iter().enumerate() {
            let refuse = |what: String| {
                ExitError::new(
                    ExitCode::RunDirectory,
                    format!(
                        "{}: line {}: {what}: lines count 0, 1, 2, …, and each has its digest; put \
                         the file back from a copy, or remove this line and all after it, and \
                         `octopus resume` goes on from the last checkpoint that the others reach",
                        path.display(),
                        index + 1
                    ),
                )
            };
            if line["iteration"] != index {
                let is = &line["iteration"];
                return Err(refuse(format!("is of iteration {is}, expected {index}")));
            }
            let digest = line["digest"].as_str().and_then(|digest| digest.parse().ok());
            digests.push(digest.ok_or_else(|| match &line["digest"] {
                Value::Null => refuse("has no digest".to_owned()),
                is => refuse(format!("has the digest {is}, which is none")),
            })?);
        }
        Ok(Self { path, digests })
    }

    /// Where it was read.
    pub fn path(&self) -> &std::path::Path {
        &self.path
    }

    /// How many iterations are recorded.
    pub fn iterations(&self) -> u64 {
        self.digests.len() as u64
    }

    /// The digest of the state after so many iterations, if that is recorded.
    pub fn digest_after(&self, iterations: u64) -> Option<Digest> {
        let last = usize::try_from(iterations.checked_sub(1)?).ok()?;
        self.digests.get(last).copied()
    }

    /// The iterations from `first` on, with their digests.
    pub fn from(&self, first: u64) -> impl Iterator<Item = (u64, Digest)> + '_ {
        let numbered = (0..).zip(&self.digests);
        numbered.filter(move |(k, _)| *k >= first).map(|(k, digest)| (k, *digest))
    }
}
