//! Checkpoints of a bucket, for commands that look at a store.

use std::path::Path;

use bucket::replica::Replica;
use bucket::{Bucket, BucketError};
use proto::{ExitCode, ExitError};
use store::checkpoint::{
    BEST, CheckpointError, CheckpointStore, Entry, LATEST, Name, Retention, Selector, Survey,
};

/// A checkpoint that is here now, whether it lies here or in a bucket.
pub(crate) struct Found {
    /// Where its files are.
    pub(crate) store: CheckpointStore,
    /// Its name.
    pub(crate) name: Name,
    /// What was brought from a bucket, which goes away with this.
    replica: Option<Replica>,
}

impl Found {
    /// Finds what a user means; of a bucket it is brought, whole and checked.
    pub(crate) fn of(selector: &Selector) -> anyhow::Result<Self> {
        if !Bucket::is_named_by(selector.path()) {
            let (store, name) = selector.locate()?;
            return Ok(Self { store, name, replica: None });
        }
        let mut replica = look(selector.path())?;
        let name = replica.locate(selector).map_err(BucketError::exit)?;
        replica.fetch(&name).map_err(BucketError::exit)?;
        Ok(Self { store: replica.store(), name, replica: Some(replica) })
    }

    /// The checkpoint at a glance, with the place that the user knows.
    pub(crate) fn entry(&self) -> anyhow::Result<Entry> {
        let mut entry = self.store.entry(&self.name)?;
        if let Some(replica) = &self.replica {
            entry.dir = replica.bucket().place(&self.name);
        }
        Ok(entry)
    }
}

/// The checkpoints of a bucket: manifests and labels alone.
pub(crate) fn look(address: &Path) -> anyhow::Result<Replica> {
    Ok(Replica::new(&address.to_string_lossy()).map_err(BucketError::exit)?)
}

/// What a store holds that lies in a bucket; none if the path names no bucket.
pub(crate) fn survey(path: &Path) -> anyhow::Result<Option<Survey>> {
    if !Bucket::is_named_by(path) {
        return Ok(None);
    }
    Ok(Some(look(path)?.survey().map_err(BucketError::exit)?))
}

/// Changes the labels of a checkpoint in a bucket by `change`, or removes it; returns what is there then. None if the
/// selector names no bucket.
pub(crate) fn change(
    selector: &Selector,
    change: impl FnOnce(&Bucket, &Name) -> Result<(), BucketError>,
) -> anyhow::Result<Option<(Entry, Name)>> {
    if !Bucket::is_named_by(selector.path()) {
        return Ok(None);
    }
    let replica = look(selector.path())?;
    let name = replica.locate(selector).map_err(BucketError::exit)?;
    let mut entry = replica.store().entry(&name)?;
    change(replica.bucket(), &name).map_err(BucketError::exit)?;
    let after = replica.bucket().list().map_err(BucketError::exit)?;
    if let Some(listed) = after.checkpoints.into_iter().find(|listed| listed.name == name) {
        entry.labels = listed.labels;
    }
    entry.dir = replica.bucket().place(&name);
    Ok(Some((entry, name)))
}

/// Removes what `retention` does not keep; returns it. One that somebody has pinned meanwhile stays.
pub(crate) fn prune(
    address: &Path,
    retention: &Retention,
    dry_run: bool,
) -> anyhow::Result<Vec<Name>> {
    let replica = look(address)?;
    let mut removed = Vec::new();
    // A checkpoint of a bucket is whole, or there is none; what is damaged there is for people to look at.
    let survey = Survey { damaged: Vec::new(), ..replica.survey().map_err(BucketError::exit)? };
    let own = replica.own().map_err(BucketError::exit)?;
    for name in retention.doomed(&survey, |entry| own.contains(&entry.name)) {
        let left = if dry_run { Ok(()) } else { replica.bucket().delete(&name) };
        match left {
            Ok(()) => removed.push(name),
            Err(BucketError::Local(CheckpointError::Pinned { .. })) => {}
            Err(error) => return Err(BucketError::exit(error).into()),
        }
    }
    Ok(removed)
}

/// Refuses a tag that moves by itself, or would select another checkpoint.
pub(crate) fn check_tag(tag: &Name) -> Result<(), BucketError> {
    let text = tag.as_str();
    let number = text.bytes().all(|byte| byte.is_ascii_digit());
    if [BEST, LATEST].contains(&text) || number || tag.iteration().is_some() {
        let reason = format!("the tag `{tag}` always selects another checkpoint; choose another");
        return Err(BucketError::Refused(reason));
    }
    Ok(())
}

/// Refuses a bucket where only a directory will do.
pub(crate) fn refuse(path: &Path) -> Result<(), ExitError> {
    if !Bucket::is_named_by(path) {
        return Ok(());
    }
    let message = format!(
        "{}: is a bucket, which this command does not change; it wants a directory",
        path.display()
    );
    Err(ExitError::new(ExitCode::Usage, message))
}
