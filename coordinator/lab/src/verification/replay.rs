//! Trains a part of a run again, beside it, and compares.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;

use anyhow::Context as _;
use channels::Domain;
use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use run::precision;
use run::preflight::Remedy;
use run::report::Reporter;
use run::session::{self, SessionSpec, StoppedBy};
use run::signals::StopRequests;
use run::supervisor::Programs;
use serde::Serialize;
use service::live::LiveRun;
use simulator::robot::Robot;
use store::checkpoint::{Checkpoint, CheckpointStore};
use store::files;
use store::provenance::Provenance;
use tempfile::TempDir;

use super::differences::{self, ProvenanceDifference};
use super::record::{self, Record, damaged};
use super::{Comparison, iterations, promise, provenance_table};

/// What helps where the system's temporary files have too little room; no flag makes a repetition smaller.
const REMEDY: Remedy =
    Remedy { elsewhere: "set TMPDIR to a directory on another disk", less: None };

/// The result of a repetition, as `--json` prints it.
#[derive(Debug, Serialize)]
pub struct Replay<'a> {
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
    /// Whether the run learned on a GPU.
    #[serde(skip)]
    gpu: bool,
    #[serde(skip)]
    ended_early: Option<ExitError>,
}

/// Repeats `run` through iteration `last` and compares every digest.
pub fn replay(run: &Record, last: u64) -> anyhow::Result<Replay<'_>> {
    let recorded = run.iterations.len() as u64;
    if last >= recorded {
        let what = format!("has no iteration {last}; it holds 0 to {}", recorded - 1);
        return Err(damaged(&RunDir::new(&run.path).metrics_jsonl(), &what).into());
    }
    let stop = StopRequests::new();
    stop.listen_and_insist("stopped at once").context("signals cannot be caught")?;
    warn_of_budgets(run);
    let checkpoint = newest_until(run, last)?;
    let from = checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.manifest.iteration);
    let dir = checkpoint.as_ref().map(|checkpoint| checkpoint.dir.clone());
    output::note(&format!(
        "training iterations {from} to {last} again, from {}",
        dir.as_ref().map_or_else(|| "nothing".to_owned(), |dir| dir.display().to_string())
    ));
    let now = Provenance::gather();
    let here = serde_json::to_value(&now).context("provenance has no JSON form")?;

    let scratch = Scratch::create()?;
    let stopped = train_again(run, &scratch.run_dir, checkpoint, last, stop, here.clone())?;
    let again = record::read_iterations(&scratch.run_dir.metrics_jsonl(), from)?;
    scratch.remove();

    let comparison = Comparison::of(&run.iterations, &again);
    let provenance = differences::of_provenance(&run.sessions, &[here]);
    let gpu = differences::on_gpu(run);
    let ended_early = (comparison.common < last + 1 - from).then(|| {
        let (code, why) = match stopped {
            StoppedBy::Signal => (ExitCode::Interrupted, "stopped by Ctrl-C"),
            _ => (ExitCode::Failure, "the training ended early"),
        };
        let compared = iterations(comparison.common);
        ExitError::new(code, format!("{why} after {compared} of {}", last + 1 - from))
    });
    Ok(Replay {
        run: &run.path,
        checkpoint: dir,
        from,
        through: last,
        same: comparison.parting.is_none(),
        comparison,
        promised: !gpu && provenance.is_empty() && !run.is_undecided(),
        provenance,
        gpu,
        ended_early,
    })
}

impl Replay<'_> {
    /// Whether all that was trained again agrees.
    pub fn is_same(&self) -> bool {
        self.same
    }

    /// Why not all of it was trained again, if it was not.
    pub fn ended_early(self) -> Option<ExitError> {
        self.ended_early
    }

    /// As a person reads it.
    pub fn text(&self) -> String {
        format!(
            "{}{}{}",
            self.comparison.sentence(["recorded", "again"]),
            provenance_table(&self.provenance, ["recorded", "again"]),
            promise(self.promised, self.same, self.gpu)
        )
    }
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
    let text = run.config.to_string();
    let recorded = Config::from_resolved_toml(&text, &origin.config().display().to_string())?;
    let robot = Robot::from_toml(&run.robot, &origin.robot())?;
    let config = Config { run: recorded.run.clone().without_housekeeping(), ..recorded };
    let config = precision::resolve(config);
    if run.is_undecided() {
        output::note(&format!(
            "note: run.precision is auto, and no checkpoint says what was chosen; training again in {}",
            precision::name(config.run.precision)
        ));
    }

    let programs = Programs::find()?;
    run::preflight::check_machine(&config, &robot, scratch, &programs.learner, &REMEDY)?;
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
            Err(error) => output::note(&format!("note: {error}; taking the checkpoint before")),
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
        output::note(&format!(
            "note: a resume changed the budget ({change}); with a learning rate that falls over \
             it, iterations before that resume are not repeated by today's configuration"
        ));
    }
}

/// A run directory among the system's temporary files that goes away with this value.
#[derive(Debug)]
struct Scratch {
    run_dir: RunDir,
    dir: TempDir,
}

impl Scratch {
    fn create() -> Result<Self, ExitError> {
        let fail = |error: std::io::Error| {
            let place = std::env::temp_dir();
            let message = format!(
                "{}: a directory cannot be created in it: {error}; {}",
                place.display(),
                REMEDY.elsewhere
            );
            ExitError::new(ExitCode::Environment, message)
        };
        // Nobody else reads what is in it.
        let dir = tempfile::Builder::new()
            .prefix("octopus-verify-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir()
            .map_err(fail)?;
        let run_dir = RunDir::new(dir.path());
        for folder in [run_dir.logs(), run_dir.checkpoints()] {
            std::fs::create_dir(folder).map_err(fail)?;
        }
        Ok(Self { run_dir, dir })
    }

    /// Removes it, and says so if that fails.
    fn remove(self) {
        let path = self.dir.path().to_owned();
        if let Err(error) = self.dir.close() {
            output::note(&format!("note: {}: cannot be removed: {error}", path.display()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scratch_directory_is_private_and_goes_away_with_everything_in_it() {
        let scratch = Scratch::create().expect("writable");
        let path = scratch.run_dir.path().to_owned();
        std::fs::write(scratch.run_dir.logs().join("learner.log"), "words").expect("writable");
        let mode = std::fs::metadata(&path).expect("exists").permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        scratch.remove();
        assert!(!path.exists());
    }
}
