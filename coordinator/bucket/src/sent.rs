//! `bucket.json` in a run directory: what is in the bucket, and what is in the way.
//!
//! `octopus status` reads it without asking anybody, and a run that goes on sends what is not in it.

use std::collections::{BTreeMap, BTreeSet};

use proto::Digest;
use proto::run_dir::RunDir;
use serde::{Deserialize, Serialize};
use store::checkpoint::{CheckpointError, CheckpointStore, Entry, Labels, Name, Ownership};
use store::{files, regular_files};

use crate::error::BucketError;
use crate::owner;

/// Name of the file.
const FILE: &str = "bucket.json";

/// A checkpoint that is in the bucket.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Copy {
    digest: Digest,
    /// Its labels as they were sent last.
    labels: Labels,
}

/// The content of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sent {
    /// Address of the bucket.
    pub address: String,
    /// The run, 32 hexadecimal digits: what tells it from others that would write below the same prefix.
    run: String,
    /// Local checkpoints that are in the bucket, too.
    checkpoints: BTreeMap<Name, Copy>,
    /// Those that were found damaged there. The run makes them again and replaces them.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    damaged: BTreeSet<Name>,
    /// What keeps the others from being sent, if anything does.
    pub trouble: Option<String>,
}

impl Sent {
    pub(crate) fn new(address: &str, run: &str) -> Self {
        Self {
            address: address.to_owned(),
            run: run.to_owned(),
            checkpoints: BTreeMap::new(),
            damaged: BTreeSet::new(),
            trouble: None,
        }
    }

    /// Of a bucket that nothing was sent to.
    pub fn none(address: &str) -> Self {
        Self::new(address, "")
    }

    /// Reads the file of a run, if it has one.
    pub fn read(run_dir: &RunDir) -> Result<Option<Self>, BucketError> {
        let path = run_dir.path().join(FILE);
        let bytes = match regular_files::read(&path, regular_files::RECORD) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(BucketError::File(format!("{}: {error}", path.display()))),
        };
        serde_json::from_slice(&bytes).map(Some).map_err(|error| {
            BucketError::File(format!(
                "{}: cannot be understood: {error}; put it back from a copy, or remove it and choose another \
                 run.checkpoints in config.toml",
                path.display()
            ))
        })
    }

    /// That of a run whose bucket has this address, which it may be the first to have.
    pub(crate) fn of(run_dir: &RunDir, address: &str) -> Result<Self, BucketError> {
        let address = address.trim_end_matches('/');
        Ok(match Self::read(run_dir)? {
            Some(sent) if sent.address == address => sent,
            // In another bucket nothing is there yet.
            Some(sent) => Self::new(address, &sent.run),
            None => Self::new(address, &owner::identifier()),
        })
    }

    pub(crate) fn write(&self, run_dir: &RunDir) -> Result<(), BucketError> {
        let mut text = serde_json::to_vec_pretty(self).expect("it has a JSON form");
        text.push(b'\n');
        let path = run_dir.path().join(FILE);
        files::replace(&path, &text).map_err(|error| BucketError::File(error.to_string()))
    }

    pub(crate) fn run(&self) -> &str {
        &self.run
    }

    pub(crate) fn add(&mut self, name: Name, digest: Digest, labels: &Labels) {
        self.damaged.remove(&name);
        self.checkpoints.insert(name, Copy { digest, labels: labels.clone() });
    }

    /// Takes note that a checkpoint is in the bucket, but not as it was sent.
    pub(crate) fn add_damaged(&mut self, name: Name) {
        self.damaged.insert(name);
    }

    /// Whether a checkpoint was found damaged in the bucket, and has not been sent since.
    pub(crate) fn is_damaged(&self, name: &Name) -> bool {
        self.damaged.contains(name)
    }

    /// Forgets what is not there locally any more.
    pub(crate) fn keep(&mut self, there: &[Entry]) {
        self.checkpoints.retain(|name, _| there.iter().any(|entry| entry.name == *name));
    }

    /// Whether a checkpoint of the run's own is in the bucket as it is.
    pub fn has(&self, entry: &Entry) -> bool {
        self.checkpoints.get(&entry.name).is_some_and(|copy| copy.digest == entry.digest)
    }

    /// The labels of a checkpoint as they were sent last.
    pub(crate) fn labels(&self, name: &Name) -> Option<&Labels> {
        self.checkpoints.get(name).map(|copy| &copy.labels)
    }

    /// Names of those of `own` that are still to be sent, the newest first.
    pub fn waiting(&self, own: &[Entry]) -> Vec<Name> {
        let mut waiting: Vec<&Entry> = own.iter().filter(|entry| !self.has(entry)).collect();
        waiting.sort_by_key(|entry| std::cmp::Reverse(entry.iteration));
        waiting.into_iter().map(|entry| entry.name.clone()).collect()
    }
}

/// The checkpoints of a run's store that go into the bucket: those that the run has come to.
///
/// One that was copied into the store is somebody else's, whatever its name: no run goes on from it, here or elsewhere.
pub fn own(store: &CheckpointStore) -> Result<Vec<Entry>, CheckpointError> {
    // Before what is recorded is read: a checkpoint of a later iteration would be taken for foreign.
    let entries = store.survey()?.entries;
    Ok(own_of(entries, &Ownership::of(store)))
}

/// The same of checkpoints that were listed before what the run had recorded was read.
pub fn own_of(mut entries: Vec<Entry>, ownership: &Ownership) -> Vec<Entry> {
    entries.retain(|entry| {
        let manifest = Some((entry.iteration, entry.digest));
        entry.name.iteration().is_some()
            && !entry.labels.imported
            && !ownership.is_foreign(&entry.dir, manifest)
    });
    entries
}
