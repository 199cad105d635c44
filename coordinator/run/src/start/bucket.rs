//! The bucket that a run's checkpoints go to, too, if it has one.

use std::time::Duration;

use bucket::mirror::Mirror;
use bucket::sent::{self, Sent};
use bucket::{Bucket, BucketError};
use output::counted;
use proto::ExitError;
use proto::config::Config;
use proto::run_dir::RunDir;
use service::live::{BucketStatus, LiveRun};
use store::checkpoint::{CheckpointStore, Name};

/// How long the end of a session waits for what is still to be sent.
const PATIENCE: Duration = Duration::from_mins(1);

/// Refuses an address that none can be, and an environment that does not fit it. Asks nobody.
pub fn check(config: &Config) -> Result<(), ExitError> {
    match config.run.checkpoints.as_str() {
        "" => Ok(()),
        address => Bucket::open(address).map(drop).map_err(BucketError::exit),
    }
}

/// Starts to send what the run commits, if that is wanted; `live` hears how far it is.
pub fn start(
    config: &Config,
    run_dir: &RunDir,
    live: &LiveRun,
) -> Result<Option<Mirror>, ExitError> {
    let Some(address) = address(config) else { return Ok(None) };
    let live = live.clone();
    let told = address.to_owned();
    let listener = move |waiting: &[Name], trouble: Option<&str>| {
        live.tell_bucket(shown(&told, waiting, trouble));
    };
    Mirror::start(address, run_dir, Box::new(listener)).map(Some).map_err(BucketError::exit)
}

/// What of a run is in its bucket, if it has one: as the run has written it down; asks nobody.
pub fn status(config: &Config, run_dir: &RunDir) -> anyhow::Result<Option<BucketStatus>> {
    let Some(address) = address(config) else { return Ok(None) };
    let own = sent::own(&CheckpointStore::new(run_dir.checkpoints()))?;
    let sent = Sent::read(run_dir).map_err(BucketError::exit)?;
    let sent = sent.filter(|sent| sent.address == address).unwrap_or_else(|| Sent::none(address));
    Ok(Some(shown(address, &sent.waiting(&own), sent.trouble.as_deref())))
}

/// The bucket's address, if there is one.
fn address(config: &Config) -> Option<&str> {
    let address = config.run.checkpoints.trim_end_matches('/');
    (!address.is_empty()).then_some(address)
}

fn shown(address: &str, waiting: &[Name], trouble: Option<&str>) -> BucketStatus {
    BucketStatus {
        address: address.to_owned(),
        waiting: waiting.iter().map(ToString::to_string).collect(),
        trouble: trouble.map(str::to_owned),
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
    let (address, run) = (&config.run.checkpoints, output::quoted(run_dir.path()));
    Some(format!(
        "note: {what}{not} in {address}; `octopus status {run}` says why, `octopus resume {run}` tries again"
    ))
}
