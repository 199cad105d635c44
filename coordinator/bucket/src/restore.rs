//! A run directory made from nothing but the bucket.
//!
//! It has what a resume asks for: the newest checkpoint that is whole and the run's own, the best one, the configuration, the robot, the
//! budgets, and the digests of all iterations so far. So the run goes on to the bits that it would have come to. What
//! is missing is for people to look at: logs, TensorBoard's files, the table of metrics begin with the resume.

use std::fs;
use std::path::Path;

use proto::run_dir::RunDir;
use store::checkpoint::{CheckpointStore, Name};
use store::recorded::Recorded;
use store::temporary;

use crate::bucket::Bucket;
use crate::error::BucketError;
use crate::fetch::{file_error, write};
use crate::listing::Listed;
use crate::ownership::{fetch_recorded_of_own, is_own, resumable};
use crate::recorded_files;
use crate::replica::nothing;
use crate::sent::Sent;

/// What was made.
#[derive(Debug)]
pub struct Restored {
    /// The checkpoint to go on from.
    pub name: Name,
    /// Newer ones that are not whole, or not the run's own, and why.
    pub passed_over: Vec<BucketError>,
    /// Bytes of checkpoints that were brought.
    pub bytes: u64,
}

/// Makes the run directory `path`, which does not exist or is empty, whole or not at all.
pub fn restore(bucket: &Bucket, path: &Path) -> Result<Restored, BucketError> {
    let listing = bucket.list()?;
    let mut passed_over: Vec<BucketError> = Vec::new();
    passed_over.extend(listing.damaged.iter().map(|(name, reason)| {
        BucketError::damaged(bucket.place(name).display().to_string(), reason.clone())
    }));
    let owner = bucket.wait(bucket.owner())?;
    let resumable = resumable(&listing);
    let (Some(owner), false) = (owner, resumable.is_empty()) else {
        return Err(passed_over.into_iter().next().unwrap_or_else(|| nothing(bucket)));
    };

    let scratch = temporary::directory_beside(path);
    let made = (|| {
        let run = RunDir::new(&scratch);
        let root = run.checkpoints();
        fs::create_dir_all(&root).map_err(|error| file_error(&root, &error))?;
        let mut base = None;
        let mut sent = Sent::new(bucket.address(), &owner.run);
        for listed in resumable {
            let fetched = bucket
                .fetch(listed, &root)
                .and_then(|dir| Ok((dir, fetch_recorded_of_own(bucket, listed, &run)?)));
            match fetched {
                Ok((dir, recorded)) => {
                    base = Some((listed, dir, recorded));
                    break;
                }
                Err(error @ (BucketError::Damaged { .. } | BucketError::Local(_))) => {
                    let _ = fs::remove_dir_all(root.join(listed.name.as_str()));
                    recorded_files::remove(&scratch);
                    sent.add_damaged(listed.name.clone());
                    passed_over.push(error);
                }
                Err(error) => return Err(error),
            }
        }
        let Some((base, dir, recorded)) = base else { return Err(passed_over.remove(0)) };
        bucket.warn_of_labels(base);
        let mut bytes = base.manifest().bytes();
        sent.add(base.name.clone(), base.manifest().digest, &base.labels);
        let base_files = CheckpointStore::new(&root).load(&dir)?;
        let mut config = base_files.config;
        // The bucket may have been moved since.
        bucket.address().clone_into(&mut config.run.checkpoints);
        write(&run.config(), config.to_toml().as_bytes())?;
        write(&run.robot(), base_files.robot_toml.as_bytes())?;
        // So that a worse one does not become the best.
        if let Some(best) = best(&listing.checkpoints, base, &recorded) {
            match bucket.fetch(best, &root) {
                Ok(_) => {
                    sent.add(best.name.clone(), best.manifest().digest, &best.labels);
                    bytes += best.manifest().bytes();
                }
                Err(error) => passed_over.push(error),
            }
        }
        CheckpointStore::new(&root).rebuild()?;
        sent.write(&run)?;
        if path.exists() {
            // Empty, as whoever calls has seen; otherwise this is refused.
            fs::remove_dir(path).map_err(|error| file_error(path, &error))?;
        }
        fs::rename(&scratch, path).map_err(|error| file_error(path, &error))?;
        let passed_over = std::mem::take(&mut passed_over);
        Ok(Restored { name: base.name.clone(), passed_over, bytes })
    })();
    if made.is_err() {
        // The error above is the one to report.
        let _ = fs::remove_dir_all(&scratch);
    }
    made
}

/// The run's own checkpoint with the lowest score, unless it is `base` itself or newer.
fn best<'a>(all: &'a [Listed], base: &Listed, recorded: &Recorded) -> Option<&'a Listed> {
    let value = |listed: &Listed| Some(listed.labels.score.as_ref()?.value);
    let scored = all.iter().filter(|listed| value(listed).is_some_and(f64::is_finite));
    let scored = scored.filter(|listed| is_own(listed, recorded));
    let earlier = scored.filter(|listed| {
        listed.name.iteration().is_some() && listed.name.iteration() <= base.name.iteration()
    });
    let best = earlier.min_by(|a, b| value(a).partial_cmp(&value(b)).expect("finite"))?;
    (best.name != base.name).then_some(best)
}
