//! `pin`, `unpin`, `tag` and `untag`.

use proto::{ExitCode, ExitError};
use store::checkpoint::{BEST, CheckpointError, store_at};

use super::common::{refused, report};
use crate::checkpoints::options::{PinArgs, TagArgs, UntagArgs};

/// Pins a checkpoint or lets it go.
pub(super) fn pin(args: &PinArgs, pinned: bool) -> anyhow::Result<()> {
    let (store, name) = args.checkpoint.locate()?;
    store.pin(&name, pinned)?;
    let done = if pinned { "pinned" } else { "not pinned" };
    match store.entry(&name) {
        Ok(entry) => report(&entry, args.json, done),
        // A damaged checkpoint can be unpinned, to be deleted, but there is no more to say of it.
        Err(_) if !args.json => output::line(&format!("{}: {done}", store.dir(&name).display())),
        Err(error) => Err(error.into()),
    }
}

/// Gives a checkpoint a tag.
pub(super) fn tag(args: &TagArgs) -> anyhow::Result<()> {
    let (store, name) = args.checkpoint.locate()?;
    store.tag(&name, args.tag.as_str()).map_err(refused(ExitCode::Usage))?;
    report(&store.entry(&name)?, args.json, &format!("tagged {}", args.tag))
}

/// Takes a tag from whichever checkpoint has it.
pub(super) fn untag(args: &UntagArgs) -> anyhow::Result<()> {
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
