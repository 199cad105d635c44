//! What a training says in the end: evaluation, learning curve, where everything is.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use lab::evaluation::{self, Summary};
use output::grouped;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use run::errors;
use run::report::Diverged;
use run::report::divergence::{CURE, Divergence};
use run::session::StoppedBy;
use run::signals::StopRequests;
use run::start::session::Ended;
use serde_json::json;
use simulator::evaluate::EvaluationOptions;
use store::checkpoint::{Checkpoint, CheckpointStore};
use store::{files, regular_files};

use crate::training_options::Ending;

/// The evaluation of its last checkpoint that lies in the run directory, if there is one.
pub(crate) fn recorded_evaluation(ended: &Ended) -> Option<Summary> {
    let bytes =
        regular_files::read(&evaluation_path(&ended.run_dir), regular_files::RECORD).ok()?;
    let summary: Summary = serde_json::from_slice(&bytes).ok()?;
    (summary.iteration == ended.outcome.iterations).then_some(summary)
}

/// The learning curve, if it was drawn.
fn curve(ended: &Ended) -> Option<PathBuf> {
    Some(ended.run_dir.curve()).filter(|curve| curve.is_file())
}

/// Where the training has diverged, unless it has recovered.
fn divergence(ended: &Ended) -> anyhow::Result<Option<Diverged>> {
    Ok(Divergence::recorded(&ended.run_dir)?.found().cloned())
}

/// How it ended, in a word or two.
fn stopped_by(ended: &Ended) -> &'static str {
    match ended.outcome.stopped_by {
        StoppedBy::Budget => "budget",
        StoppedBy::TimeLimit => "time limit",
        StoppedBy::Signal => "signal",
        StoppedBy::Pause => "pause",
    }
}

/// Prints the result as JSON.
pub(crate) fn print_json(ended: &Ended, evaluation: Option<&Summary>) -> anyhow::Result<()> {
    output::json(&json!({
        "run_dir": ended.run_dir.path(),
        "iterations": ended.outcome.iterations,
        "env_steps": ended.outcome.env_steps,
        "stopped_by": stopped_by(ended),
        "checkpoint": ended.outcome.checkpoint,
        "curve": curve(ended),
        "divergence": divergence(ended)?,
        "evaluation": evaluation,
    }))
}

/// Evaluates the final policy and prints what a person wants to know next.
pub(crate) fn conclude(ended: &Ended, ending: Ending) -> anyhow::Result<()> {
    let Ended { run_dir, outcome, stop } = ended;
    let evaluation = if ending.no_eval || outcome.stopped_by == StoppedBy::Signal {
        None
    } else {
        let checkpoint = CheckpointStore::new(run_dir.checkpoints()).load(&outcome.checkpoint)?;
        Some(evaluate(checkpoint, stop)?)
    };
    // What was found is shown, also where it cannot be kept.
    let kept = evaluation.as_ref().map_or(Ok(()), |evaluation| keep(run_dir, evaluation));
    if ending.json {
        print_json(ended, evaluation.as_ref())?;
        return kept;
    }
    output::line(&format!(
        "{}, {} env-steps, ended by the {}",
        output::counted(outcome.iterations, "iteration"),
        grouped(outcome.env_steps),
        stopped_by(ended)
    ))?;
    if let Some(diverged) = divergence(ended)? {
        output::line(&format!("warning: {diverged}; {CURE}"))?;
    }
    if let Some(evaluation) = &evaluation {
        output::line(&format!("\n{}\n", evaluation.table(output::columns(), ending.agents)))?;
        if kept.is_ok() {
            output::line(&format!("evaluation  {}", evaluation_path(run_dir).display()))?;
        }
    }
    if let Some(curve) = curve(ended) {
        output::line(&format!("curve       {}", curve.display()))?;
    }
    output::line(&format!("checkpoint  {}", outcome.checkpoint.display()))?;
    if outcome.stopped_by != StoppedBy::Budget {
        output::line(&format!("go on with  octopus resume {}", output::quoted(run_dir.path())))?;
    }
    kept
}

/// Writes what an evaluation found into the run directory.
fn keep(run_dir: &RunDir, evaluation: &Summary) -> anyhow::Result<()> {
    let path = evaluation_path(run_dir);
    let text = serde_json::to_vec_pretty(evaluation).context("the evaluation has no JSON form")?;
    files::replace(&path, &text).map_err(|error| {
        let (run, path) = (output::quoted(run_dir.path()), output::quoted(&path));
        let then = format!("`octopus eval {run} --json > {path}` evaluates it again");
        errors::name_what_follows_room(error.into(), &then)
    })
}

/// Evaluates with the default options; Ctrl-C, which is only counted until here, ends it.
fn evaluate(checkpoint: Checkpoint, stop: &StopRequests) -> anyhow::Result<Summary> {
    let asked = stop.count();
    let dir = checkpoint.dir.clone();
    let evaluation =
        std::thread::spawn(move || evaluation::evaluate(checkpoint, &EvaluationOptions::default()));
    while !evaluation.is_finished() {
        if stop.count() > asked {
            let message =
                format!("evaluation stopped; `octopus eval {}` repeats it", output::quoted(&dir));
            return Err(ExitError::new(ExitCode::Interrupted, message).into());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    evaluation.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn evaluation_path(run_dir: &RunDir) -> PathBuf {
    run_dir.path().join("evaluation.json")
}
