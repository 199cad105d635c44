//! Which checkpoints of a bucket its run has come to.
//!
//! Earlier versions also sent those that somebody had copied into a run's store. No run goes on from them, and they are
//! the newest of nothing.

use proto::run_dir::RunDir;
use store::checkpoint::Manifest;
use store::recorded::Recorded;

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::listing::{Listed, Listing};

/// Those of which a run could go on from, if they are its own: the newest first.
pub(crate) fn resumable(listing: &Listing) -> Vec<&Listed> {
    let has_state =
        |listed: &&Listed| listed.name.iteration().is_some() && listed.manifest().has_state();
    let mut resumable: Vec<&Listed> = listing.checkpoints.iter().filter(has_state).collect();
    resumable.sort_by_key(|listed| std::cmp::Reverse(listed.name.iteration()));
    resumable
}

/// Brings what the run had recorded up to a checkpoint into the directory `run`. Refuses a checkpoint that its run has
/// not come to.
pub(crate) fn fetch_recorded_of_own(
    bucket: &Bucket,
    listed: &Listed,
    run: &RunDir,
) -> Result<Recorded, BucketError> {
    bucket.fetch_recorded(listed, run.path())?;
    let place = || bucket.place(&listed.name).display().to_string();
    let recorded = Recorded::read(run).map_err(|_| {
        BucketError::damaged(place(), "what its run had recorded by then cannot be understood")
    })?;
    if is_own(listed, &recorded) {
        return Ok(recorded);
    }
    Err(BucketError::damaged(place(), "is no checkpoint that its run has made: it was copied here"))
}

/// Whether the run has come to a checkpoint, if that is recorded.
pub(crate) fn is_own(listed: &Listed, recorded: &Recorded) -> bool {
    let Manifest { iteration, digest, .. } = *listed.manifest();
    let is_told = recorded.iterations() > 0 && iteration > 0;
    !is_told || recorded.digest_after(iteration) == Some(digest)
}
