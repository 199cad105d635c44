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
    /// stays as it is; one with another digest was made under another budget, and is replaced in one step.
    pub(crate) async fn send(
        &self,
        lease: &Lease,
        name: &Name,
        dir: &Path,
        run_dir: &RunDir,
    ) -> Result<(), BucketError> {
        self.check(lease).await?;
        let manifest = Manifest::read(dir)?;
        let at = folder(name);
        let key = format!("{at}/{MANIFEST}");
        for _ in 0..TRIES {
            let before = self.read(&key).await?;
            let there = before.as_ref().and_then(|small| Record::parse(&small.bytes).ok());
            if there.as_ref().is_some_and(|record| record.manifest.digest == manifest.digest) {
                return Ok(());
            }
            let run = self.send_files(&at, dir, &manifest, run_dir).await?;
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
        dir: &Path,
        manifest: &Manifest,
        run_dir: &RunDir,
    ) -> Result<BTreeMap<String, FileEntry>, BucketError> {
        for (file, entry) in &manifest.files {
            self.upload(&format!("{at}/{}", object(file, entry)), &dir.join(file), entry).await?;
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
            if self.labels(name).await?.pinned {
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
