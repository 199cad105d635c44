//! The bucket that a run's checkpoints go to, too, if it has one.

use std::time::Duration;

use bucket::mirror::Mirror;
use bucket::{Bucket, BucketError};
use output::counted;
use proto::ExitError;
use proto::config::Config;
use proto::run_dir::RunDir;

/// How long the end of a session waits for what is still to be sent.
const PATIENCE: Duration = Duration::from_mins(1);

/// Refuses an address that none can be, and an environment that does not fit it. Asks nobody.
pub fn check(config: &Config) -> Result<(), ExitError> {
    match config.run.checkpoints.as_str() {
        "" => Ok(()),
        address => Bucket::open(address).map(drop).map_err(BucketError::exit),
    }
}

/// Starts to send what the run commits, if that is wanted.
pub fn start(config: &Config, run_dir: &RunDir) -> Result<Option<Mirror>, ExitError> {
    match config.run.checkpoints.as_str() {
        "" => Ok(None),
        address => Mirror::start(address, run_dir).map(Some).map_err(BucketError::exit),
    }
}

/// Sends what is left, while nobody insists that this ends; says what could not be sent.
pub fn finish(
    mirror: Option<Mirror>,
    config: &Config,
    run_dir: &RunDir,
    goes_on: impl Fn() -> bool,
) -> Option<String> {
    let left = mirror?.finish(PATIENCE, goes_on);
    let what = match left {
        Some(0) => return None,
        Some(1) => "one checkpoint is".to_owned(),
        Some(left) => format!("{} are", counted(left as u64, "checkpoint")),
        None => "not all checkpoints are".to_owned(),
    };
    let not = if left.is_some() { " not" } else { "" };
    let (address, shown) = (&config.run.checkpoints, run_dir.path().display());
    Some(format!(
        "note: {what}{not} in {address}; `octopus status {shown}` says why, `octopus resume {shown}` sends \
         what is missing"
    ))
}
