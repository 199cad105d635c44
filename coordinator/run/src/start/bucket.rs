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
use store::checkpoint::{CheckpointStore, Entry, Name, Ownership};

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

/// What of the checkpoints in a run's store is in its bucket, if it has one: as the run has written it down; asks nobody.
/// `ownership` is what the run had recorded when it was looked at after its store.
pub fn status(
    config: &Config,
    run_dir: &RunDir,
    entries: Vec<Entry>,
    ownership: &Ownership,
) -> anyhow::Result<Option<BucketStatus>> {
    let Some(address) = address(config) else { return Ok(None) };
    let own = sent::own_of(entries, ownership);
    let sent = Sent::read(run_dir).map_err(BucketError::exit)?;
    let sent = sent.filter(|sent| sent.address == address).unwrap_or_else(|| Sent::none(address));
    Ok(Some(shown(address, &sent.waiting(&own), sent.trouble.as_deref())))
}

/// What [`status`] has to know of a run's store, before what the run has recorded is read; nothing without a bucket.
pub fn entries(config: &Config, store: &CheckpointStore) -> anyhow::Result<Vec<Entry>> {
    Ok(if address(config).is_some() { store.survey()?.entries } else { Vec::new() })
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proto::config::{Layers, Preset};
    use simulator::robot::Robot;
    use store::checkpoint::fixtures::snapshot_of;
    use store::recorded::Recorded;

    use super::*;

    /// They may be long; the file is not even there.
    #[test]
    fn the_status_reads_no_metrics_that_were_read_already() {
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path());
        let keys =
            ["network.hidden=[4]", "network.critic_hidden=[4]", "run.checkpoints=file:///b/a"];
        let layers = keys.iter().try_fold(Layers::new(Preset::Tuned, None), |l, set| l.set(set));
        let config = layers.and_then(|layers| layers.resolve()).expect("valid");
        let store = CheckpointStore::new(run_dir.checkpoints());
        let robot = Robot::builtin("paper").expect("built in").to_toml();
        // The second was made by another run.
        for (iteration, first) in [(1, 0.0), (2, 1.0)] {
            let snapshot = snapshot_of(&config, iteration, first);
            store.commit(&snapshot, &config, &robot, &serde_json::json!({})).expect("commits");
        }
        let line = |k: u64| {
            let digest = snapshot_of(&config, k + 1, 0.0).digest.to_string();
            (String::new(), serde_json::json!({ "iteration": k, "digest": digest }))
        };
        let recorded = Recorded::of_lines(run_dir.metrics_jsonl(), &[line(0), line(1)]);
        let ownership = Ownership::of_run(recorded.ok().map(Arc::new));
        let entries = entries(&config, &store).expect("readable");
        assert_eq!(entries.len(), 2);
        let status = status(&config, &run_dir, entries, &ownership).expect("readable");
        assert_eq!(status.expect("a bucket").waiting, ["iteration-00000001"]);
    }
}
