//! `pin`, `unpin`, `tag` and `untag`.

use bucket::{Bucket, BucketError};
use proto::{ExitCode, ExitError};
use store::checkpoint::{BEST, CheckpointError, store_at};

use super::common::{refused, report};
use crate::checkpoints::from_bucket;
use crate::checkpoints::options::{PinArgs, TagArgs, UntagArgs};

/// Pins a checkpoint or lets it go.
pub(super) fn pin(args: &PinArgs, pinned: bool) -> anyhow::Result<()> {
    let done = if pinned { "pinned" } else { "not pinned" };
    let there = from_bucket::change(&args.checkpoint, |bucket, name| bucket.pin(name, pinned))?;
    if let Some((entry, _)) = there {
        return report(&entry, args.json, done);
    }
    let (store, name) = args.checkpoint.locate()?;
    store.pin(&name, pinned)?;
    match store.entry(&name) {
        Ok(entry) => report(&entry, args.json, done),
        // A damaged checkpoint can be unpinned, to be deleted, but there is no more to say of it.
        Err(_) if !args.json => output::line(&format!("{}: {done}", store.dir(&name).display())),
        Err(error) => Err(error.into()),
    }
}

/// Gives a checkpoint a tag.
pub(super) fn tag(args: &TagArgs) -> anyhow::Result<()> {
    let done = format!("tagged {}", args.tag);
    let there = from_bucket::change(&args.checkpoint, |bucket, name| {
        from_bucket::check_tag(&args.tag)?;
        bucket.tag(name, &args.tag)
    })?;
    if let Some((entry, _)) = there {
        return report(&entry, args.json, &done);
    }
    let (store, name) = args.checkpoint.locate()?;
    store.tag(&name, args.tag.as_str()).map_err(refused(ExitCode::Usage))?;
    report(&store.entry(&name)?, args.json, &done)
}

/// Takes a tag from whichever checkpoint has it.
pub(super) fn untag(args: &UntagArgs) -> anyhow::Result<()> {
    if Bucket::is_named_by(&args.store) {
        return untag_in_bucket(args);
    }
    let store = store_at(&args.store)?;
    let mut holders = store.entries()?;
    holders.retain(|entry| entry.labels.has_tag(args.tag.as_str()));
    let Some(first) = holders.first() else {
        let what = format!("has no checkpoint with the tag `{}`", args.tag);
        return Err(CheckpointError::NotFound { path: store.root().to_owned(), what }.into());
    };
    if args.tag.as_str() == BEST {
        let reason = format!("the tag `{BEST}` follows the scores and cannot be removed");
        return Err(ExitError::new(ExitCode::Usage, reason).into());
    }
    for holder in &holders {
        store.untag(&holder.name, args.tag.as_str())?;
    }
    report(&store.entry(&first.name)?, args.json, &format!("not tagged {} any more", args.tag))
}

fn untag_in_bucket(args: &UntagArgs) -> anyhow::Result<()> {
    let replica = from_bucket::look(&args.store)?;
    from_bucket::check_tag(&args.tag).map_err(BucketError::exit)?;
    let bucket = replica.bucket();
    let Some(first) = bucket.untag(&args.tag).map_err(BucketError::exit)?.into_iter().next() else {
        let what = format!("has no checkpoint with the tag `{}`", args.tag);
        return Err(CheckpointError::NotFound { path: args.store.clone(), what }.into());
    };
    let mut entry = replica.store().entry(&first)?;
    entry.labels.tags.retain(|tag| *tag != args.tag);
    entry.dir = bucket.place(&first);
    report(&entry, args.json, &format!("not tagged {} any more", args.tag))
}
