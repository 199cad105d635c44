//! A local copy of what a bucket holds, for commands that read: everything that works on a store works on it.

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

use object_store::ObjectMeta;
use proto::Digest;
use proto::run_dir::RunDir;
use store::checkpoint::{CheckpointStore, DamagedEntry, LATEST, Name, Selector, Survey};
use store::recorded::Recorded;
use store::scratch::{self, Scratch};

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::fetch::{file_error, summarise, write};
use crate::listing::{Listed, Listing};
use crate::ownership::{fetch_recorded_of_own, is_own, resumable};
use crate::record::{LABELS, Record};

/// A store in a directory that goes away with it, like that of a run. At first it holds manifests and labels alone.
#[derive(Debug)]
pub struct Replica {
    bucket: Bucket,
    dir: Scratch,
    listing: Listing,
    /// The newest checkpoint that a run would go on from, and what the run had recorded by then, once it was asked for.
    newest: OnceCell<Option<(Name, Recorded)>>,
    whole: BTreeMap<Name, Digest>,
    refused: BTreeMap<Name, Refused>,
    /// Whether the index is of what was here before.
    stale: bool,
}

/// A checkpoint that was not whole, as it was then: it is not brought again before it is another.
#[derive(Debug)]
struct Refused {
    record: Record,
    objects: Vec<ObjectMeta>,
    reason: String,
}

impl Replica {
    /// Looks at a bucket.
    pub fn new(address: &str) -> Result<Self, BucketError> {
        let bucket = Bucket::open(address)?;
        let dir = Scratch::new("bucket").map_err(|error| file_error(&scratch::place(), &error))?;
        let listing = bucket.list()?;
        let (whole, refused) = (BTreeMap::new(), BTreeMap::new());
        let newest = OnceCell::new();
        let replica = Self { bucket, dir, listing, newest, whole, refused, stale: false };
        let root = replica.root();
        fs::create_dir(&root).map_err(|error| file_error(&root, &error))?;
        for listed in &replica.listing.checkpoints {
            replica.bucket.warn_of_labels(listed);
            summarise(listed, &root)?;
        }
        replica.index()?;
        Ok(replica)
    }

    /// The bucket.
    pub fn bucket(&self) -> &Bucket {
        &self.bucket
    }

    /// The store.
    pub fn store(&self) -> CheckpointStore {
        CheckpointStore::new(self.root())
    }

    /// What is around the store, as it is around that of a run.
    fn run(&self) -> RunDir {
        RunDir::new(self.dir.path())
    }

    fn root(&self) -> PathBuf {
        self.run().checkpoints()
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

    /// The newest checkpoint that a run would go on from, and what the run had recorded by then. From then on the store
    /// is that of the run, and tells the run's own checkpoints from others.
    fn newest_own(&self) -> Result<Option<&(Name, Recorded)>, BucketError> {
        if self.newest.get().is_none() {
            let found = self.find_newest_own()?;
            // Nobody else sets it.
            let _ = self.newest.set(found);
        }
        Ok(self.newest.get().and_then(Option::as_ref))
    }

    fn find_newest_own(&self) -> Result<Option<(Name, Recorded)>, BucketError> {
        let run = self.run();
        let [config, metrics] = [run.config(), run.metrics_jsonl()];
        for of_before in [&config, &metrics] {
            let _ = fs::remove_file(of_before);
        }
        for listed in resumable(&self.listing) {
            let scratch =
                tempfile::tempdir_in(run.path()).map_err(|error| file_error(run.path(), &error))?;
            let brought = RunDir::new(scratch.path());
            match fetch_recorded_of_own(&self.bucket, listed, &brought) {
                Ok(recorded) => {
                    if recorded.iterations() > 0 {
                        fs::rename(brought.metrics_jsonl(), &metrics)
                            .map_err(|error| file_error(&metrics, &error))?;
                        // A run has one, whatever is in it.
                        write(&config, b"")?;
                    }
                    return Ok(Some((listed.name.clone(), recorded)));
                }
                // A resume passes it over, too.
                Err(BucketError::Damaged { .. } | BucketError::Local(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Names of the checkpoints that the run has come to; the others were copied beside them.
    pub fn own(&self) -> Result<BTreeSet<Name>, BucketError> {
        let Some((_, recorded)) = self.newest_own()? else { return Ok(BTreeSet::new()) };
        let own = self.listing.checkpoints.iter().filter(|listed| is_own(listed, recorded));
        Ok(own.map(|listed| listed.name.clone()).collect())
    }

    /// The name of the checkpoint that a selector of this bucket means.
    pub fn locate(&self, selector: &Selector) -> Result<Name, BucketError> {
        let newest = selector.choice().is_none_or(|choice| choice.as_str() == LATEST);
        if newest {
            let (name, _) = self.newest_own()?.ok_or_else(|| nothing(&self.bucket))?;
            return Ok(name.clone());
        }
        let root = self.root();
        let (_, name) = selector.elsewhere(&root).locate().map_err(|error| {
            // Its own words, about the place that the user knows.
            let local = root.display().to_string();
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
        self.bucket.fetch(listed, &self.root())?;
        let digest = listed.manifest().digest;
        self.whole.insert(name.clone(), digest);
        Ok(())
    }

    /// Brings all files of all checkpoints; returns why some are not here.
    pub fn fetch_all(&mut self) -> Result<Vec<String>, BucketError> {
        self.stale = true;
        self.bring()
    }

    /// Brings what is missing, and sees to the index where that or something before it makes another of it.
    fn bring(&mut self) -> Result<Vec<String>, BucketError> {
        let missing =
            self.listing.checkpoints.iter().filter(|listed| !self.is_whole(listed)).cloned();
        let missing: Vec<Listed> = missing.collect();
        let mut reasons = Vec::new();
        for listed in missing {
            let name = &listed.name;
            // Before its files are read: what is mended meanwhile is another one.
            let mut objects = self.bucket.wait(self.bucket.metas_of(name))?;
            // What users say of it makes it no other.
            objects.retain(|object| object.location.filename() != Some(LABELS));
            let before = self.refused.get(name);
            if let Some(before) = before
                && (&before.record, &before.objects) == (&listed.record, &objects)
            {
                reasons.push(before.reason.clone());
                continue;
            }
            // Also for the next time, if this one fails.
            self.stale = true;
            match self.fetch(name) {
                Ok(()) => {
                    self.refused.remove(name);
                }
                Err(error @ (BucketError::Damaged { .. } | BucketError::Local(_))) => {
                    // What is listed and not whole is not shown.
                    let _ = fs::remove_dir_all(self.root().join(name.as_str()));
                    self.whole.remove(name);
                    let reason = error.to_string();
                    reasons.push(reason.clone());
                    let refused = Refused { record: listed.record, objects, reason };
                    self.refused.insert(listed.name, refused);
                }
                Err(error) => return Err(error),
            }
        }
        if self.stale {
            self.index()?;
            self.stale = false;
        }
        Ok(reasons)
    }

    /// Looks at the bucket again, and brings what is new or was changed; what is gone there goes.
    pub fn refresh(&mut self) -> Result<Vec<String>, BucketError> {
        let listing = self.bucket.list()?;
        let gone =
            self.listing.checkpoints.iter().filter(|before| {
                !listing.checkpoints.iter().any(|listed| listed.name == before.name)
            });
        for before in gone {
            let _ = fs::remove_dir_all(self.root().join(before.name.as_str()));
            self.whole.remove(&before.name);
            self.refused.remove(&before.name);
        }
        let other = |listed: &&Listed| !self.listing.checkpoints.contains(listed);
        for listed in listing.checkpoints.iter().filter(other) {
            self.bucket.warn_of_labels(listed);
        }
        let whole = listing.checkpoints.iter().filter(|listed| self.is_whole(listed));
        for listed in whole.filter(other) {
            summarise(listed, &self.root())?;
        }
        if listing.checkpoints != self.listing.checkpoints {
            self.stale = true;
            self.newest = OnceCell::new();
        }
        self.listing = listing;
        self.bring()
    }

    /// Whether all files of it are here.
    fn is_whole(&self, listed: &Listed) -> bool {
        self.whole.get(&listed.name) == Some(&listed.manifest().digest)
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
        let all = &self.listing.checkpoints;
        // Whose they are says which is the best one, and the newest where all are shown.
        if self.stale || all.iter().any(|listed| listed.labels.score.is_some()) {
            self.newest_own()?;
        }
        if !all.is_empty() {
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

#[cfg(test)]
mod tests {
    use store::checkpoint::{CONFIG, FORMAT, FileEntry, MANIFEST, Manifest, POLICY, ROBOT, STATE};
    use tempfile::TempDir;

    use super::*;
    use crate::{record, recorded_files};

    /// A bucket in a directory with one checkpoint, whose files hold their names.
    fn bucket() -> (TempDir, Bucket, Name) {
        let dir = tempfile::tempdir().expect("tempdir");
        let bucket = Bucket::open(&format!("file://{}", dir.path().display())).expect("opens");
        let name = send(&bucket, 1, &[POLICY, CONFIG, ROBOT], None);
        (dir, bucket, name)
    }

    /// Puts a checkpoint there of a run that has recorded this.
    fn send(bucket: &Bucket, iteration: u64, files: &[&str], run: Option<&RunDir>) -> Name {
        let name = Name::of_iteration(iteration);
        let entry = |bytes: &[u8]| FileEntry {
            len: bytes.len() as u64,
            blake3: blake3::hash(bytes).to_hex().to_string(),
        };
        let files = files.iter().map(|file| ((*file).to_owned(), entry(file.as_bytes())));
        let manifest = Manifest {
            format: FORMAT,
            iteration,
            env_steps: 1,
            digest: Digest::default(),
            created_unix_s: 0,
            provenance: serde_json::Value::Null,
            files: files.collect(),
            origins: Vec::new(),
        };
        for (file, entry) in &manifest.files {
            put(bucket, &below(&name, file, entry), file);
        }
        let mut recorded = BTreeMap::new();
        for (file, bytes) in run.map_or(Vec::new(), |run| recorded_files::of(run, 1).expect("read"))
        {
            let entry = entry(&bytes);
            bucket.wait(bucket.write_named(&below(&name, &file, &entry), bytes)).expect("written");
            recorded.insert(file, entry);
        }
        let record = Record::new(manifest, recorded);
        let key = format!("{}/{}", record::folder(&name), record::MANIFEST);
        bucket.wait(bucket.write_named(&key, record.to_json())).expect("written");
        name
    }

    fn below(name: &Name, file: &str, entry: &FileEntry) -> String {
        format!("{}/{}", record::folder(name), record::object(file, entry))
    }

    fn put(bucket: &Bucket, below: &str, text: &str) {
        bucket.wait(bucket.write_named(below, text.into())).expect("written");
    }

    /// Of a bucket that an earlier version has written: a resume goes on from the first.
    #[test]
    fn what_was_copied_into_a_run_is_the_newest_and_the_best_of_nothing() {
        let (_dir, bucket, _) = bucket();
        let place = tempfile::tempdir().expect("tempdir");
        let run = RunDir::new(place.path());
        let line = format!("{{\"iteration\":0,\"digest\":\"{}\"}}\n", Digest::default());
        std::fs::write(run.metrics_jsonl(), line).expect("written");
        let [first, copied] = [1, 2]
            .map(|iteration| send(&bucket, iteration, &[STATE, POLICY, CONFIG, ROBOT], Some(&run)));
        let replica = Replica::new(bucket.address()).expect("a replica");
        assert_eq!(replica.own().expect("read"), BTreeSet::from([first.clone()]));
        let located = |choice: &str| {
            let selector = format!("{}{choice}", bucket.address()).parse().expect("one");
            replica.locate(&selector).expect("there")
        };
        assert_eq!([located(""), located(":latest")], [first.clone(), first.clone()]);
        assert_eq!(located(":2"), copied, "by its name it is found");
        // Nor is it the best, however good it is.
        for (name, value) in [(&first, 2.0), (&copied, 1.0)] {
            let labels = format!(
                "{{\"score\":{{\"value\":{value},\"episodes\":1,\"steps\":1,\"seed\":0}}}}"
            );
            put(&bucket, &format!("{}/{LABELS}", record::folder(name)), &labels);
        }
        let mut replica = replica;
        for fresh in [false, true] {
            if fresh {
                replica = Replica::new(bucket.address()).expect("a replica");
            } else {
                replica.refresh().expect("reads");
            }
            let best = format!("{}:best", bucket.address()).parse().expect("a selector");
            assert_eq!(replica.locate(&best).expect("there"), first);
            let entries = replica.survey().expect("listed").entries;
            let best = entries.iter().filter(|entry| entry.labels.has_tag("best"));
            assert_eq!(best.map(|entry| &entry.name).collect::<Vec<_>>(), [&first]);
        }
    }

    /// It would be brought every ten seconds for ever.
    #[test]
    fn a_damaged_checkpoint_is_brought_again_only_when_it_was_changed() {
        let (_dir, bucket, name) = bucket();
        let entry = bucket.list().expect("listed").checkpoints[0].manifest().files[POLICY].clone();
        let policy = below(&name, POLICY, &entry);
        put(&bucket, &policy, "damaged");
        let mut replica = Replica::new(bucket.address()).expect("a replica");
        let first = replica.fetch_all().expect("reads");
        assert!(first[0].contains(POLICY), "{first:?}");
        // A mark that a second attempt would remove.
        let mark = replica.root().join(name.as_str());
        fs::create_dir(&mark).expect("writes");
        assert_eq!(replica.refresh().expect("reads"), first, "it is still said");
        assert!(mark.exists(), "it was brought again");
        put(&bucket, &policy, POLICY);
        assert_eq!(replica.refresh().expect("reads"), [""; 0]);
        assert_eq!(replica.store().entries().expect("lists").len(), 1);
    }

    #[test]
    fn what_has_not_changed_is_not_written_again() {
        let (_dir, bucket, name) = bucket();
        let mut replica = Replica::new(bucket.address()).expect("a replica");
        assert_eq!(replica.fetch_all().expect("reads"), [""; 0]);
        let catalogue = replica.root().join("catalogue.sqlite");
        let manifest = replica.root().join(name.as_str()).join(MANIFEST);
        for file in [&catalogue, &manifest] {
            fs::remove_file(file).expect("is there");
        }
        assert_eq!(replica.refresh().expect("reads"), [""; 0]);
        assert!(!catalogue.exists() && !manifest.exists(), "they are written again");
        put(&bucket, &format!("{}/{LABELS}", record::folder(&name)), "{\"pinned\":true}");
        // Something is in the way once.
        fs::create_dir(&catalogue).expect("made");
        replica.refresh().expect_err("no file can be written there");
        fs::remove_dir(&catalogue).expect("removed");
        assert_eq!(replica.refresh().expect("reads"), [""; 0]);
        let entries = replica.store().entries().expect("lists");
        assert!(entries[0].labels.pinned && catalogue.exists());
    }
}
