//! Trains a part of a run again, beside it, and compares.

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
use store::checkpoint::{Checkpoint, CheckpointStore, Manifest, Name};
use store::files;
use store::provenance::Provenance;
use store::scratch;

use super::comparison::Comparison;
use super::differences::{self, ProvenanceDifference};
use super::record::{self, Iteration, Record, damaged};
use super::wording::{iterations, promise, provenance_table};

/// What helps where the system's temporary files have too little room; no flag makes a repetition smaller.
pub const REMEDY: Remedy =
    Remedy { elsewhere: "set TMPDIR to a directory on another disk", less: None, flags: &[] };

/// The result of a repetition, as `--json` prints it.
#[derive(Debug, Serialize)]
pub struct Replay<'a> {
    /// The directory of the run.
    run: &'a std::path::Path,
    /// Where it began; none if from nothing.
    checkpoint: Option<PathBuf>,
    /// First iteration that was trained again.
    from: u64,
    /// Last one; that before a change of the budget, if no checkpoint lies behind that.
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
    let checkpoint = newest_until(run, last)?;
    let planned = checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.manifest.iteration);
    let part = Part::of(run, planned, last);
    let dir = checkpoint.as_ref().map(|checkpoint| checkpoint.dir.clone());
    output::note(&format!(
        "training iterations {planned} to {} again, from {}",
        part.last,
        dir.as_ref().map_or_else(|| "nothing".to_owned(), |dir| dir.display().to_string())
    ));
    let now = Provenance::gather();
    let here = serde_json::to_value(&now).context("provenance has no JSON form")?;

    let scratch = Scratch::create()?;
    let stopped = train_again(run, &scratch.run_dir, checkpoint, &part, stop, here.clone())?;
    let again = read_again(&scratch.run_dir, planned)?;
    scratch.remove();
    // From nothing, if the learner could not start from the checkpoint.
    let from = again.first().map_or(planned, |first| first.iteration);
    let dir = dir.filter(|_| from == planned);
    let as_planned = from == planned || Part::of(run, from, last) == part;

    let comparison = Comparison::of(&run.iterations, &again);
    let provenance = differences::of_provenance(&run.sessions, &[here]);
    let gpu = differences::on_gpu(run);
    let ended_early = (comparison.common < last + 1 - from).then(|| {
        let (code, why) = match stopped {
            StoppedBy::Signal => (ExitCode::Interrupted, "stopped by Ctrl-C".to_owned()),
            _ if comparison.common == part.last + 1 - from => {
                let change = part.last + 1;
                let why = format!(
                    "the budget, over which the learning rate falls, was another from iteration {change} \
                     on, and no whole checkpoint lies between that and iteration {last}: ended"
                );
                (ExitCode::Failure, why)
            }
            _ => (ExitCode::Failure, "the training ended early".to_owned()),
        };
        let compared = iterations(comparison.common);
        ExitError::new(code, format!("{why} after {compared} of {}", last + 1 - from))
    });
    Ok(Replay {
        run: &run.path,
        checkpoint: dir,
        from,
        through: part.last,
        same: comparison.parting.is_none(),
        comparison,
        promised: !gpu
            && provenance.is_empty()
            && !run.is_undecided()
            && part.budget_is_known
            && as_planned,
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

/// What is trained again, under one budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Part {
    /// The last iteration.
    last: u64,
    /// `run.env_steps` that was in force, where another than the last one was.
    env_steps: Option<u64>,
    /// Whether nothing says that it may have been yet another.
    budget_is_known: bool,
}

impl Part {
    /// What can be trained again from `from` through `last`: at most until the budget was changed.
    fn of(run: &Record, from: u64, last: u64) -> Self {
        if !differences::depends_on_budget(run) {
            return Self { last, env_steps: None, budget_is_known: true };
        }
        let undated = run.undated_budgets();
        for change in &undated {
            output::note(&format!(
                "note: a resume changed the budget ({change}); with a learning rate that falls over \
                 it, iterations before that resume are not repeated by today's configuration"
            ));
        }
        let budgets = run.budgets_until(last + 1);
        let behind = budgets.partition_point(|budget| budget.from <= from);
        Self {
            last: budgets.get(behind).map_or(last, |next| next.from - 1),
            env_steps: budgets[..behind].last().map(|budget| budget.env_steps),
            budget_is_known: undated.is_empty(),
        }
    }
}

/// The iterations that were trained again, from `planned` on, or from the first.
fn read_again(scratch: &RunDir, planned: u64) -> Result<Vec<Iteration>, ExitError> {
    let path = scratch.metrics_jsonl();
    // The learner has refused the checkpoint.
    record::read_iterations(&path, planned)
        .or_else(|error| record::read_iterations(&path, 0).map_err(|_| error))
}

/// Trains in `scratch` from `checkpoint`, or from nothing, what `part` says.
fn train_again(
    run: &Record,
    scratch: &RunDir,
    checkpoint: Option<Checkpoint>,
    part: &Part,
    stop: StopRequests,
    provenance: serde_json::Value,
) -> anyhow::Result<StoppedBy> {
    let origin = RunDir::new(&run.path);
    let text = run.config.to_string();
    let recorded = Config::from_resolved_toml(&text, &origin.config().display().to_string())?;
    let robot = Robot::from_toml(&run.robot, &origin.robot())?;
    let config = Config { run: recorded.run.clone().without_housekeeping(), ..recorded };
    let mut config = precision::resolve(config);
    if let Some(env_steps) = part.env_steps {
        config.run.env_steps = env_steps;
    }
    // Other machines may have made all of the run.
    config.run.workers = config.run.workers.max(1);
    if run.is_undecided() {
        output::note(&format!(
            "note: run.precision is auto, and no checkpoint says what was chosen; training again in {}",
            precision::name(config.run.precision)
        ));
    }

    let programs = Programs::find()?;
    run::preflight::check_machine(&config, &robot, scratch, &programs.learner, None, &REMEDY)?;
    files::replace(&scratch.robot(), run.robot.as_bytes())?;
    files::replace(&scratch.config(), config.to_toml().as_bytes())?;
    // Progress is shown over what is repeated, not over the budget of the run.
    let mut shown = config.clone();
    shown.run.env_steps = (part.last + 1) * config.steps_per_iteration();
    let from = checkpoint.as_ref().map(|checkpoint| checkpoint.manifest.iteration);
    let mut reporter = Reporter::create(scratch, &shown, from, false)?;
    let spec = SessionSpec {
        run_dir: scratch.clone(),
        config,
        robot,
        resume: checkpoint,
        programs,
        gateway: None,
        provenance,
        domain: Domain::fresh(),
        stop,
        until: Some(part.last + 1),
        live: LiveRun::new(),
    };
    let outcome = session::run(&spec, &mut reporter);
    let finished = reporter.finish();
    let outcome = outcome?;
    finished?;
    Ok(outcome.stopped_by)
}

/// The newest whole checkpoint of the run's own from which iteration `last` is still to come. Of those that
/// are passed over for it, it is said why.
fn newest_until(run: &Record, last: u64) -> anyhow::Result<Option<Checkpoint>> {
    let store = CheckpointStore::new(RunDir::new(&run.path).checkpoints());
    let mut reasons = Vec::new();
    let mut found = None;
    for dir in store.list()?.into_iter().rev() {
        let name = dir.file_name().and_then(|name| name.to_str()?.parse::<Name>().ok());
        if name.and_then(|name| name.iteration()).is_some_and(|iteration| iteration > last) {
            continue;
        }
        match store.load(&dir) {
            // The state before the first iteration is that of a start.
            Ok(there) if !there.manifest.has_state() || there.manifest.iteration == 0 => {}
            Ok(there) if there.manifest.iteration > last => {}
            Ok(there) => {
                let Some(reason) = foreign(run, &there) else {
                    found = Some(there);
                    break;
                };
                reasons.push(reason);
            }
            // Removed since it was listed.
            Err(_) if !dir.exists() => {}
            Err(error) => reasons.push(error.to_string()),
        }
    }
    let instead = match &found {
        Some(found) => format!("checkpoint {}", found.manifest.iteration),
        None => "nothing".to_owned(),
    };
    for reason in reasons {
        output::note(&format!("note: {reason}; training again from {instead} instead"));
    }
    Ok(found)
}

/// Why a checkpoint is not what the run had come to.
fn foreign(run: &Record, checkpoint: &Checkpoint) -> Option<String> {
    let Manifest { iteration, digest, .. } = &checkpoint.manifest;
    let ended = usize::try_from(iteration - 1).ok().and_then(|last| run.iterations.get(last))?;
    (ended.digest != *digest).then(|| {
        format!(
            "{}: has digest {digest}, but iteration {} is recorded to have ended with {}",
            checkpoint.dir.display(),
            ended.iteration,
            ended.digest
        )
    })
}

/// A run directory among the system's temporary files that goes away with this value.
#[derive(Debug)]
struct Scratch {
    run_dir: RunDir,
    dir: scratch::Scratch,
}

impl Scratch {
    fn create() -> Result<Self, ExitError> {
        let fail = |error: std::io::Error| {
            let place = scratch::place();
            let message = format!(
                "{}: a directory cannot be created in it: {error}; {}",
                place.display(),
                REMEDY.elsewhere
            );
            ExitError::new(ExitCode::Environment, message)
        };
        let dir = scratch::Scratch::new("verify").map_err(fail)?;
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
    use std::os::unix::fs::PermissionsExt as _;

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
