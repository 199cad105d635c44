//! Trains a part of a run again, beside it, and compares.

use std::os::unix::fs::DirBuilderExt as _;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use proto::channel::Domain;
use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use serde::Serialize;
use sim_worker::robot::Robot;

use super::differences::{self, ProvenanceDifference};
use super::record::{self, Record, damaged};
use super::{Comparison, iterations, promise, provenance_table};
use crate::checkpoint::{Checkpoint, CheckpointStore};
use crate::commands::{read_config, train};
use crate::live::LiveRun;
use crate::provenance::Provenance;
use crate::report::Reporter;
use crate::session::{self, SessionSpec, StoppedBy};
use crate::signals::StopRequests;
use crate::supervisor::Programs;
use crate::{files, output};

/// The result of a repetition, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Replay<'a> {
    /// The directory of the run.
    run: &'a std::path::Path,
    /// Where it began; none if from nothing.
    checkpoint: Option<PathBuf>,
    /// First iteration that was trained again.
    from: u64,
    /// Last one.
    through: u64,
    /// Whether all agree.
    same: bool,
    #[serde(flatten)]
    comparison: Comparison,
    /// Whether the promise extends over this program and machine.
    promised: bool,
    provenance: Vec<ProvenanceDifference>,
}

/// Repeats `run` through iteration `last` and compares every digest.
pub(super) fn run(run: &Record, last: u64, json: bool) -> anyhow::Result<()> {
    let recorded = run.iterations.len() as u64;
    if last >= recorded {
        let what = format!("has no iteration {last}; it holds 0 to {}", recorded - 1);
        return Err(damaged(&RunDir::new(&run.path).metrics_jsonl(), &what).into());
    }
    let stop = StopRequests::new();
    stop.listen().context("signals cannot be caught")?;
    warn_of_budgets(run);
    let checkpoint = newest_until(run, last)?;
    let from = checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.manifest.iteration);
    let dir = checkpoint.as_ref().map(|checkpoint| checkpoint.dir.clone());
    eprintln!(
        "training iterations {from} to {last} again, from {}",
        dir.as_ref().map_or_else(|| "nothing".to_owned(), |dir| dir.display().to_string())
    );
    let now = Provenance::gather();
    let here = serde_json::to_value(&now).context("provenance has no JSON form")?;

    let scratch = Scratch::create()?;
    let stopped = train_again(run, &scratch.0, checkpoint, last, stop, here.clone())?;
    let again = record::read_iterations(&scratch.0.metrics_jsonl(), from)?;
    drop(scratch);

    let comparison = Comparison::of(&run.iterations, &again);
    let provenance = differences::of_provenance(&run.sessions, &[here]);
    let gpu = differences::on_gpu(run);
    let result = Replay {
        run: &run.path,
        checkpoint: dir,
        from,
        through: last,
        same: comparison.parting.is_none(),
        comparison,
        promised: !gpu && provenance.is_empty(),
        provenance,
    };
    if json {
        output::json(&result)?;
    } else {
        output::line(&format!(
            "{}{}{}",
            comparison.sentence(["recorded", "again"]),
            provenance_table(&result.provenance, ["recorded", "again"]),
            promise(result.promised, result.same, gpu)
        ))?;
    }
    comparison.verdict()?;
    if comparison.common < last + 1 - from {
        let (code, why) = match stopped {
            StoppedBy::Signal => (ExitCode::Interrupted, "stopped by Ctrl-C"),
            _ => (ExitCode::Failure, "the training ended early"),
        };
        let compared = iterations(comparison.common);
        let message = format!("{why} after {compared} of {}", last + 1 - from);
        return Err(ExitError::new(code, message).into());
    }
    Ok(())
}

/// Trains in `scratch` from `checkpoint`, or from nothing, through iteration `last`.
fn train_again(
    run: &Record,
    scratch: &RunDir,
    checkpoint: Option<Checkpoint>,
    last: u64,
    stop: StopRequests,
    provenance: serde_json::Value,
) -> anyhow::Result<StoppedBy> {
    let origin = RunDir::new(&run.path);
    let recorded = read_config(&origin)?;
    let robot = Robot::from_toml(&run.robot, &origin.robot())?;
    let config = Config { run: recorded.run.clone().without_housekeeping(), ..recorded };

    let programs = Programs::find()?;
    train::check_machine(&config, &robot, scratch, &programs)?;
    files::replace(&scratch.robot(), run.robot.as_bytes())?;
    files::replace(&scratch.config(), config.to_toml().as_bytes())?;
    // Progress is shown over what is repeated, not over the budget of the run.
    let mut shown = config.clone();
    shown.run.env_steps = (last + 1) * config.steps_per_iteration();
    let from = checkpoint.as_ref().map(|checkpoint| checkpoint.manifest.iteration);
    let mut reporter = Reporter::create(scratch, &shown, from, false)?;
    let spec = SessionSpec {
        run_dir: scratch.clone(),
        config,
        robot,
        resume: checkpoint,
        programs,
        provenance,
        domain: Domain::fresh(),
        stop,
        until: Some(last + 1),
        live: LiveRun::new(),
    };
    let outcome = session::run(&spec, &mut reporter);
    let finished = reporter.finish();
    let outcome = outcome?;
    finished?;
    Ok(outcome.stopped_by)
}

/// The newest whole checkpoint from which iteration `last` is still to come.
fn newest_until(run: &Record, last: u64) -> anyhow::Result<Option<Checkpoint>> {
    let store = CheckpointStore::new(RunDir::new(&run.path).checkpoints());
    for dir in store.list()?.into_iter().rev() {
        match store.load(&dir) {
            Ok(found) if found.manifest.iteration <= last && found.manifest.has_state() => {
                return Ok(Some(found));
            }
            Ok(_) => {}
            Err(error) => eprintln!("note: {error}; taking the checkpoint before"),
        }
    }
    Ok(None)
}

/// Says so if the run's budget was changed on the way: a learning rate that falls over the budget
/// then fell otherwise in the earlier sessions than it does in the repetition.
fn warn_of_budgets(run: &Record) {
    let changes = run
        .sessions
        .iter()
        .filter_map(|session| session["overrides"].as_array())
        .flatten()
        .filter_map(|change| change.as_str())
        .filter(|change| change.starts_with("run.env_steps "));
    for change in changes {
        eprintln!(
            "note: a resume changed the budget ({change}); with a learning rate that falls over \
             it, iterations before that resume are not repeated by today's configuration"
        );
    }
}

/// A run directory among the system's temporary files that goes away with this value.
#[derive(Debug)]
struct Scratch(RunDir);

impl Scratch {
    fn create() -> Result<Self, ExitError> {
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let name = format!(
            "octopus-verify-{}-{}",
            std::process::id(),
            since_epoch.as_nanos() % 1_000_000_007
        );
        let path = std::env::temp_dir().join(name);
        let fail = |error: std::io::Error| {
            let message = format!("{}: cannot be created: {error}", path.display());
            ExitError::new(ExitCode::Environment, message)
        };
        // Nobody else's directory is taken over, and nobody else reads what is in it.
        std::fs::DirBuilder::new().mode(0o700).create(&path).map_err(fail)?;
        let scratch = Self(RunDir::new(&path));
        for folder in [scratch.0.logs(), scratch.0.checkpoints()] {
            std::fs::create_dir(folder).map_err(fail)?;
        }
        Ok(scratch)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(self.0.path()) {
            eprintln!("note: {}: cannot be removed: {error}", self.0.path().display());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scratch_directory_is_private_and_goes_away_with_everything_in_it() {
        use std::os::unix::fs::PermissionsExt as _;
        let scratch = Scratch::create().expect("writable");
        let path = scratch.0.path().to_owned();
        std::fs::write(scratch.0.logs().join("learner.log"), "words").expect("writable");
        let mode = std::fs::metadata(&path).expect("exists").permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        drop(scratch);
        assert!(!path.exists());
    }
}
