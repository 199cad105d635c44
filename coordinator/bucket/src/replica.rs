//! A local copy of what a bucket holds, for commands that read: everything that works on a store works on it.

use std::collections::BTreeMap;
use std::fs;

use proto::Digest;
use store::checkpoint::{CheckpointStore, DamagedEntry, LATEST, Name, Selector, Survey};
use tempfile::TempDir;

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::fetch::{file_error, summarise};
use crate::listing::{Listed, Listing};

/// A store in a directory that goes away with it. At first it holds manifests and labels alone.
#[derive(Debug)]
pub struct Replica {
    bucket: Bucket,
    dir: TempDir,
    listing: Listing,
    whole: BTreeMap<Name, Digest>,
}

impl Replica {
    /// Looks at a bucket.
    pub fn new(address: &str) -> Result<Self, BucketError> {
        let bucket = Bucket::open(address)?;
        let dir = tempfile::Builder::new()
            .prefix("spaceoctopus-bucket-")
            .tempdir()
            .map_err(|error| file_error(&std::env::temp_dir(), &error))?;
        let listing = bucket.list()?;
        for listed in &listing.checkpoints {
            summarise(listed, dir.path())?;
        }
        let replica = Self { bucket, dir, listing, whole: BTreeMap::new() };
        replica.index()?;
        Ok(replica)
    }

    /// The bucket.
    pub fn bucket(&self) -> &Bucket {
        &self.bucket
    }

    /// The store.
    pub fn store(&self) -> CheckpointStore {
        CheckpointStore::new(self.dir.path())
    }

    /// All checkpoints at a glance, with their places in the bucket.
    pub fn survey(&self) -> Result<Survey, BucketError> {
        let mut survey = self.store().survey()?;
        for entry in &mut survey.entries {
            entry.dir = self.bucket.place(&entry.name);
        }
        survey.damaged = self
            .listing
            .damaged
            .iter()
            .map(|(name, reason)| DamagedEntry {
                name: name.clone(),
                dir: self.bucket.place(name),
                reason: reason.clone(),
            })
            .collect();
        Ok(survey)
    }

    /// The name of the checkpoint that a selector of this bucket means.
    pub fn locate(&self, selector: &Selector) -> Result<Name, BucketError> {
        let newest = selector.choice().is_none_or(|choice| choice.as_str() == LATEST);
        if newest {
            let own = self.listing.checkpoints.iter().filter(|listed| {
                listed.name.iteration().is_some() && listed.manifest().has_state()
            });
            return own
                .max_by_key(|listed| listed.name.iteration())
                .map_or_else(|| Err(nothing(&self.bucket)), |listed| Ok(listed.name.clone()));
        }
        let (_, name) = selector.elsewhere(self.dir.path()).locate().map_err(|error| {
            // Its own words, about the place that the user knows.
            let local = self.dir.path().display().to_string();
            let what = error.to_string().replace(&local, self.bucket.address());
            let what = what.strip_prefix(self.bucket.address()).unwrap_or(&what);
            BucketError::NotFound {
                place: self.bucket.address().to_owned(),
                what: what.trim_start_matches(": ").to_owned(),
            }
        })?;
        Ok(name)
    }

    /// Brings all files of a checkpoint.
    pub fn fetch(&mut self, name: &Name) -> Result<(), BucketError> {
        let listed = self.listed(name)?;
        self.bucket.fetch(listed, self.dir.path())?;
        let digest = listed.manifest().digest;
        self.whole.insert(name.clone(), digest);
        Ok(())
    }

    /// Brings all files of all checkpoints; returns why some are not here.
    pub fn fetch_all(&mut self) -> Result<Vec<BucketError>, BucketError> {
        let names = self
            .listing
            .checkpoints
            .iter()
            .filter(|listed| self.whole.get(&listed.name) != Some(&listed.manifest().digest));
        let names: Vec<Name> = names.map(|listed| listed.name.clone()).collect();
        let mut failures = Vec::new();
        for name in names {
            match self.fetch(&name) {
                Ok(()) => {}
                Err(error @ (BucketError::Damaged { .. } | BucketError::Local(_))) => {
                    // What is listed and not whole is not shown.
                    let _ = fs::remove_dir_all(self.dir.path().join(name.as_str()));
                    failures.push(error);
                }
                Err(error) => return Err(error),
            }
        }
        self.index()?;
        Ok(failures)
    }

    /// Looks at the bucket again, and brings what is new or was changed; what is gone there goes.
    pub fn refresh(&mut self) -> Result<Vec<BucketError>, BucketError> {
        let listing = self.bucket.list()?;
        let gone =
            self.listing.checkpoints.iter().filter(|before| {
                !listing.checkpoints.iter().any(|listed| listed.name == before.name)
            });
        for before in gone {
            let dir = self.dir.path().join(before.name.as_str());
            let _ = fs::remove_dir_all(&dir);
            self.whole.remove(&before.name);
        }
        for listed in &listing.checkpoints {
            if self.whole.get(&listed.name) == Some(&listed.manifest().digest) {
                summarise(listed, self.dir.path())?;
            }
        }
        self.listing = listing;
        self.fetch_all()
    }

    fn listed(&self, name: &Name) -> Result<&Listed, BucketError> {
        let listed = self.listing.checkpoints.iter().find(|listed| listed.name == *name);
        listed.ok_or_else(|| BucketError::NotFound {
            place: self.bucket.address().to_owned(),
            what: format!("has no checkpoint `{name}`"),
        })
    }

    /// The catalogue, and the tag `best` where the scores say.
    fn index(&self) -> Result<(), BucketError> {
        if !self.listing.checkpoints.is_empty() {
            self.store().rebuild()?;
        }
        Ok(())
    }
}

/// There is nothing to go on from.
pub(crate) fn nothing(bucket: &Bucket) -> BucketError {
    BucketError::NotFound {
        place: bucket.address().to_owned(),
        what: "holds no checkpoint from which training can go on; is the prefix right?".to_owned(),
    }
}
