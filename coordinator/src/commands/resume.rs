//! `octopus resume`: a stopped run goes on as if it had never stopped.

use std::path::Path;

use anyhow::Context as _;
use proto::channel::Domain;
use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use simulator::robot::Robot;

use super::train::{self, Counter, Ended, Start};
use crate::checkpoint::{Checkpoint, CheckpointError, CheckpointStore, MANIFEST};
use crate::cli::ResumeArgs;
use crate::lock::RunLock;
use crate::preflight::Remedy;
use crate::provenance::Provenance;
use crate::report;
use crate::report::promised::Promised;
use crate::supervisor::Programs;
use crate::{files, output};

/// What helps an old run that its disk does not carry.
const REMEDY: Remedy = Remedy {
    elsewhere: "move the run directory to another disk",
    less: Some("lower run.checkpoints_kept in its config.toml"),
};

/// Resumes, evaluates and says where everything is.
pub fn run(args: &ResumeArgs) -> anyhow::Result<()> {
    match resume(args)? {
        Resumed::Trained(ended) => ended.conclude(args.ending),
        Resumed::Done(ended) if args.ending.json => {
            let evaluation = ended.recorded_evaluation().filter(|_| !args.ending.no_eval);
            ended.print_json(evaluation.as_ref())
        }
        Resumed::Done(_) => Ok(()),
    }
}

/// What came of it.
pub(super) enum Resumed {
    /// A session.
    Trained(Ended),
    /// Nothing: the run has done already what it was asked for.
    Done(Ended),
}

impl Resumed {
    /// How the run ended, now or before.
    pub(super) fn into_inner(self) -> Ended {
        match self {
            Self::Trained(ended) | Self::Done(ended) => ended,
        }
    }
}

/// Resumes.
pub(super) fn resume(args: &ResumeArgs) -> anyhow::Result<Resumed> {
    let run_dir = super::run_directory(&args.run_dir)?;
    check_no_checkpoint(&run_dir)?;
    train::check_token_file(&args.http)?;
    let domain = Domain::fresh();
    let lock = RunLock::acquire(&run_dir.lock(), &domain)?;

    let before = super::read_config(&run_dir)?;
    let robot_text = super::read_text(&run_dir.robot())?;
    let robot = Robot::from_toml(&robot_text, &run_dir.robot())?;
    let resume = find_start(&run_dir)?;
    match &resume {
        Some(checkpoint) => check_unchanged(&run_dir, &before, &robot_text, checkpoint)?,
        // Nothing was lost: the same seed gives the same run from the beginning.
        None => eprintln!("note: the run was stopped before its first checkpoint and starts anew"),
    }

    let (config, overrides) = override_limits(&before, args)?;
    if let Some(last) = &resume
        && last.manifest.iteration >= config.planned_iterations()
    {
        let done = last.manifest.iteration;
        eprintln!(
            "note: nothing to do: {} {} done, {} wanted; a larger --iterations or --env-steps goes on",
            output::counted(done, "iteration"),
            if done == 1 { "is" } else { "are" },
            config.planned_iterations()
        );
        return Ok(Resumed::Done(Ended::before(run_dir, last)));
    }
    for change in &overrides {
        eprintln!("note: {change}");
    }

    let programs = Programs::find()?;
    train::check_machine(&config, &robot, &run_dir, &programs, &REMEDY)?;
    let counter = Counter::open(&args.http, &run_dir)?;
    let provenance = Provenance::gather();
    if !overrides.is_empty() {
        files::replace(&run_dir.config(), config.to_toml().as_bytes())?;
    }
    train::record(&run_dir, &provenance, &overrides)?;
    std::fs::create_dir_all(run_dir.logs()).map_err(|error| {
        ExitError::new(
            ExitCode::RunDirectory,
            format!("{}: cannot be created: {error}", run_dir.logs().display()),
        )
    })?;
    // Another budget is another course of the learning rate.
    let same = config.run.env_steps == before.run.env_steps;
    let start =
        Start { run_dir, config, robot, resume, same, programs, domain, provenance, counter };
    train::run_session(start, lock, args.ending.quiet).map(Resumed::Trained)
}

/// Refuses a checkpoint: it has a configuration and a robot as a run has, and would become one.
fn check_no_checkpoint(run_dir: &RunDir) -> Result<(), ExitError> {
    let dir = run_dir.path();
    if !dir.join(MANIFEST).is_file() {
        return Ok(());
    }
    let message = format!(
        "{0}: is a checkpoint, not a run directory; `octopus eval {0}` measures it, and \
         `octopus resume` wants the directory of the run that it comes from",
        dir.display()
    );
    Err(ExitError::new(ExitCode::RunDirectory, message))
}

/// The newest checkpoint that the metrics reach; none if the run has none at all.
///
/// They reach every one: a checkpoint is committed after its lines are durable. Only where a file
/// was lost or cut by other means does the run go further back, so that no iteration is left out.
fn find_start(run_dir: &RunDir) -> anyhow::Result<Option<Checkpoint>> {
    let store = CheckpointStore::new(run_dir.checkpoints());
    let newest = match store.latest() {
        Ok(checkpoint) => checkpoint,
        Err(CheckpointError::NotFound { .. }) => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let recorded = report::recorded(run_dir)?;
    let iteration = newest.manifest.iteration;
    if iteration <= recorded {
        return Ok(Some(newest));
    }
    let metrics = run_dir.metrics_jsonl();
    let lost = format!(
        "{}: the iterations from {recorded} on are missing, but the newest checkpoint is of {iteration}",
        metrics.display(),
    );
    match store.latest_until(recorded) {
        Ok(older) => {
            eprintln!(
                "warning: {lost}; going on from checkpoint {} instead, so that there is no gap",
                older.manifest.iteration
            );
            // That one's digest is known all the same.
            Promised::read(run_dir)?.add([(iteration - 1, newest.manifest.digest)])?;
            Ok(Some(older))
        }
        Err(CheckpointError::NotFound { .. }) => Err(ExitError::new(
            ExitCode::RunDirectory,
            format!(
                "{lost}, and there is none of {recorded} or fewer to go on from without a gap; put \
                 the file back from a copy, or make the same run again: `octopus train --config {}`. \
                 `octopus eval {}` measures what was learned",
                run_dir.config().display(),
                newest.dir.display(),
            ),
        )
        .into()),
        Err(error) => Err(error).context(format!("{lost}, and the one before cannot be taken")),
    }
}

/// The configuration with the limits of the command line, and what they changed.
fn override_limits(before: &Config, args: &ResumeArgs) -> anyhow::Result<(Config, Vec<String>)> {
    let mut config = before.clone();
    if let Some(workers) = args.workers {
        config.run.workers = workers as usize;
    }
    if let Some(env_steps) = args.limits.env_steps {
        config.run.env_steps = env_steps;
    }
    if let Some(iterations) = args.limits.iterations {
        config.run.env_steps = iterations.saturating_mul(config.steps_per_iteration());
    }
    if let Some(limit) = args.limits.time_limit {
        config.run.time_limit_s = limit.as_secs_f64();
    }
    config.validate()?;
    let mut overrides = Vec::new();
    let mut changed = |key: &str, old: &dyn std::fmt::Display, new: &dyn std::fmt::Display| {
        let (old, new) = (old.to_string(), new.to_string());
        if old != new {
            overrides.push(format!("{key} is now {new}, was {old}"));
        }
    };
    changed("run.workers", &before.run.workers, &config.run.workers);
    changed("run.env_steps", &before.run.env_steps, &config.run.env_steps);
    changed("run.time_limit_s", &before.run.time_limit_s, &config.run.time_limit_s);
    Ok((config, overrides))
}

/// A run goes on with what it began with: only limits, processes and housekeeping may differ.
fn check_unchanged(
    run_dir: &RunDir,
    config: &Config,
    robot_toml: &str,
    checkpoint: &Checkpoint,
) -> Result<(), ExitError> {
    let refuse = |path: &Path, what: &str| {
        Err(ExitError::new(
            ExitCode::RunDirectory,
            format!(
                "{}: {what} since checkpoint {}; put it back (the checkpoint holds a copy), or start \
                 another run with `octopus train --config`",
                path.display(),
                checkpoint.dir.display()
            ),
        ))
    };
    let then = &checkpoint.config;
    let groups = [
        ("task", config.task == then.task),
        ("robot", config.robot == then.robot),
        ("env", config.env == then.env),
        ("network", config.network == then.network),
        ("algorithm", config.algorithm == then.algorithm),
        ("optimizer", config.optimizer == then.optimizer),
        ("run", config.run.continues(&then.run)),
    ];
    if let Some((group, _)) = groups.iter().find(|(_, same)| !same) {
        return refuse(&run_dir.config(), &format!("group `{group}` was changed"));
    }
    if robot_toml != checkpoint.robot_toml {
        return refuse(&run_dir.robot(), "was changed");
    }
    Ok(())
}
