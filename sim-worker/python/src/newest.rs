//! Which checkpoints of a store are the run's own, and which is the newest, as `octopus eval` sees it.

use std::cmp::Reverse;
use std::path::{Path, PathBuf};

use proto::Digest;

use crate::config::read;
use crate::directories::{directories, iteration};
use crate::labels::Labels;
use crate::manifest::Manifest;

/// Longest metrics that are read (bytes).
const MAX_METRICS: u64 = 1 << 30;

/// A checkpoint's directory with its manifest, or what is wrong with that.
pub(crate) type Candidate = (PathBuf, Result<Manifest, String>);

/// Checkpoints from which training can go on, or whose manifest cannot be read: the run's own, newest first, and then those that the run
/// has not come to itself.
pub(crate) fn candidates(store: &Path) -> impl Iterator<Item = Candidate> {
    let mut found: Vec<PathBuf> =
        directories(store).filter(|dir| iteration(dir).is_some()).collect();
    found.sort_by_key(|dir| Reverse(iteration(dir)));
    let ownership = Ownership::of(store);
    let is_foreign =
        |(dir, manifest): &Candidate| ownership.is_foreign(dir, manifest.as_ref().ok());
    let with_manifest = |dir: PathBuf| {
        let manifest = Manifest::read(&dir);
        (dir, manifest)
    };
    let (foreign, own): (Vec<_>, Vec<_>) =
        found.into_iter().map(with_manifest).partition(is_foreign);
    let all = own.into_iter().chain(foreign);
    all.filter(|(_, manifest)| manifest.as_ref().map_or(true, Manifest::has_state))
}

/// What tells a run's own checkpoints from others.
pub(crate) struct Ownership {
    /// Digests of the iterations of the run that the store belongs to; none if it belongs to none. They are empty where they cannot be read.
    recorded: Option<Vec<Digest>>,
}

impl Ownership {
    /// Of the run that the store belongs to, if it belongs to one.
    pub(crate) fn of(store: &Path) -> Self {
        let run = store.parent().filter(|run| {
            store.file_name().is_some_and(|name| name == "checkpoints")
                && run.join("config.toml").is_file()
        });
        Self { recorded: run.map(recorded) }
    }

    /// Whether the run has not come to the checkpoint itself. Where nothing is recorded, or its manifest cannot be read, what was imported is
    /// foreign.
    pub(crate) fn is_foreign(&self, dir: &Path, manifest: Option<&Manifest>) -> bool {
        let Some(recorded) = &self.recorded else { return false };
        match manifest {
            Some(Manifest { iteration, digest, .. }) if *iteration > 0 && !recorded.is_empty() => {
                let last = usize::try_from(iteration - 1).ok();
                last.and_then(|last| recorded.get(last)) != Some(digest)
            }
            _ => Labels::read(dir).imported,
        }
    }
}

/// Digests of the iterations of a run; empty where they cannot be read.
fn recorded(run: &Path) -> Vec<Digest> {
    let bytes = read(&run.join("metrics.jsonl"), MAX_METRICS).unwrap_or_default();
    let whole = bytes.split_inclusive(|byte| *byte == b'\n').filter(|line| line.ends_with(b"\n"));
    let values = whole.map_while(|line| serde_json::from_slice::<serde_json::Value>(line).ok());
    let digests = values.enumerate().map(|(index, line)| {
        (line["iteration"] == index).then(|| line["digest"].as_str()?.parse().ok()).flatten()
    });
    digests.collect::<Option<_>>().unwrap_or_default()
}
