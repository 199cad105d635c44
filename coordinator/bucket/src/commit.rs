//! A checkpoint is sent: its files, then its manifest; or removed: its manifest, then its files.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use futures_util::TryStreamExt as _;
use object_store::ObjectMeta;
use proto::run_dir::RunDir;
use store::checkpoint::{CheckpointError, FileEntry, Manifest, Name};

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::objects::Written;
use crate::owner::Lease;
use crate::record::{LABELS, MANIFEST, Record, folder, object};
use crate::recorded_files;

/// How often a manifest is tried that somebody else writes at the same moment.
const TRIES: usize = 3;

impl Bucket {
    /// Sends the checkpoint in `dir` of the run in `run_dir`, under a lease. One that is there with the same digest
    /// stays as it is, unless it is known to be `damaged`; one with another digest was made under another budget.
    /// Either is replaced in one step.
    pub(crate) async fn send(
        &self,
        lease: &Lease,
        name: &Name,
        (dir, run_dir): (&Path, &RunDir),
        damaged: bool,
    ) -> Result<(), BucketError> {
        self.check(lease).await?;
        let manifest = Manifest::read(dir)?;
        let at = folder(name);
        let key = format!("{at}/{MANIFEST}");
        for _ in 0..TRIES {
            let before = self.read(&key).await?;
            let there = before.as_ref().and_then(|small| Record::parse(&small.bytes).ok());
            let is_same = |record: &Record| record.manifest.digest == manifest.digest;
            if !damaged && there.as_ref().is_some_and(is_same) {
                return Ok(());
            }
            // Files that are there were sent by an attempt before this one, or are what is to be replaced.
            let begun = !damaged;
            let run = self.send_files(&at, (dir, run_dir), &manifest, begun).await?;
            let record = Record::new(manifest.clone(), run);
            if self.write_after(&key, before.as_ref(), record.to_json()).await? == Written::Lost {
                // Whoever was first may have sent the same.
                continue;
            }
            if before.is_some() {
                self.sweep(name, &record).await?;
            }
            return Ok(());
        }
        let reason = "another writer is changing it at the same time".to_owned();
        Err(BucketError::Away { place: self.shown(&key), reason })
    }

    async fn send_files(
        &self,
        at: &str,
        (dir, run_dir): (&Path, &RunDir),
        manifest: &Manifest,
        begun: bool,
    ) -> Result<BTreeMap<String, FileEntry>, BucketError> {
        for (file, entry) in &manifest.files {
            let below = format!("{at}/{}", object(file, entry));
            self.upload(&below, &dir.join(file), entry, begun).await?;
        }
        let mut run = BTreeMap::new();
        for (file, bytes) in recorded_files::of(run_dir, manifest.iteration)? {
            let blake3 = blake3::hash(&bytes).to_hex().to_string();
            let entry = FileEntry { len: bytes.len() as u64, blake3 };
            self.write_named(&format!("{at}/{}", object(&file, &entry)), bytes).await?;
            run.insert(file, entry);
        }
        Ok(run)
    }

    /// Removes what a manifest that was replaced had listed.
    async fn sweep(&self, name: &Name, record: &Record) -> Result<(), BucketError> {
        let kept: BTreeSet<String> = record
            .objects()
            .chain([MANIFEST.to_owned(), LABELS.to_owned()])
            .map(|object| format!("{}/{object}", folder(name)))
            .collect();
        for below in self.objects_of(name).await? {
            if !kept.contains(&below) {
                self.remove(&below).await?;
            }
        }
        Ok(())
    }

    /// Removes a checkpoint: from its first step on there is none.
    pub fn delete(&self, name: &Name) -> Result<(), BucketError> {
        self.wait(async {
            if self.labels(name).await?.labels.pinned {
                return Err(CheckpointError::Pinned { path: self.place(name) }.into());
            }
            self.remove(&format!("{}/{MANIFEST}", folder(name))).await?;
            for below in self.objects_of(name).await? {
                self.remove(&below).await?;
            }
            Ok(())
        })
    }

    /// All objects of a checkpoint, below the prefix.
    async fn objects_of(&self, name: &Name) -> Result<Vec<String>, BucketError> {
        let found = self.metas_of(name).await?;
        let names = found.iter().filter_map(|meta| meta.location.filename());
        Ok(names.map(|object| format!("{}/{object}", folder(name))).collect())
    }

    /// What the bucket says of them, in the order of their names; it says something else of content that was replaced.
    pub(crate) async fn metas_of(&self, name: &Name) -> Result<Vec<ObjectMeta>, BucketError> {
        let at = folder(name);
        let found: Result<Vec<ObjectMeta>, _> =
            self.objects.list(Some(&self.path(&at))).try_collect().await;
        let mut found = found.map_err(|error| BucketError::of(self.shown(&at), &error))?;
        found.sort_by(|a, b| a.location.cmp(&b.location));
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use proto::Digest;
    use store::checkpoint::{CONFIG, FORMAT, POLICY, ROBOT, STATE};

    use super::*;

    /// A run that is resumed from a bucket makes again what is damaged there.
    #[test]
    fn what_is_damaged_in_the_bucket_is_replaced_where_that_is_known() {
        let place = tempfile::tempdir().expect("tempdir");
        let [there, dir, run] = ["there", "dir", "run"].map(|part| place.path().join(part));
        for path in [&there, &dir, &run] {
            std::fs::create_dir(path).expect("made");
        }
        // So large that it is sent in parts.
        let files =
            [(STATE, 9 << 20), (POLICY, 10), (CONFIG, 10), (ROBOT, 10)].map(|(file, len)| {
                let bytes = vec![b'a'; len];
                std::fs::write(dir.join(file), &bytes).expect("written");
                let blake3 = blake3::hash(&bytes).to_hex().to_string();
                (file.to_owned(), FileEntry { len: len as u64, blake3 })
            });
        let manifest = Manifest {
            format: FORMAT,
            iteration: 1,
            env_steps: 1,
            digest: Digest::default(),
            created_unix_s: 0,
            provenance: serde_json::Value::Null,
            files: files.into(),
            origins: Vec::new(),
        };
        let text = serde_json::to_vec(&manifest).expect("JSON");
        std::fs::write(dir.join(store::checkpoint::MANIFEST), text).expect("written");
        let run = RunDir::new(run);
        std::fs::write(run.metrics_jsonl(), "{}\n").expect("written");

        let bucket = Bucket::open(&format!("file://{}", there.display())).expect("opens");
        let (lease, name) = (Lease::new("a"), Name::of_iteration(1));
        bucket.wait(bucket.claim(&lease)).expect("nobody's");
        let send = |damaged| {
            bucket.wait(bucket.send(&lease, &name, (&dir, &run), damaged)).expect("sent");
        };
        send(false);
        let fetch = || {
            let listed = bucket.list().expect("listed").checkpoints.remove(0);
            let to = tempfile::tempdir().expect("tempdir");
            bucket.fetch(&listed, to.path()).map(drop)
        };
        fetch().expect("whole");
        let state = there.join(folder(&name)).join(object(STATE, &manifest.files[STATE]));
        let mut bytes = std::fs::read(&state).expect("read");
        bytes[7] ^= 1;
        std::fs::write(&state, bytes).expect("written");
        fetch().expect_err("one bit is another");
        // Nobody reads it again for that.
        send(false);
        fetch().expect_err("it stays as it is");
        send(true);
        fetch().expect("it was replaced");
    }
}
