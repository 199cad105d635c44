//! `octopus sweep`: many trainings that differ in keys of their configurations and in their seeds.
//!
//! * `file`: what is tried, as a person writes it, read by `keys`; `plan`: the trials of it;
//! * `place`: where everything is; `slots`: what is done at a time, and on which processors;
//! * `drive`: the loop.

mod drive;
mod file;
mod keys;
mod options;
mod place;
mod plan;
mod slots;

use std::collections::BTreeSet;

use anyhow::Context as _;
use lab::experiments::command_line::{option, path_option, typed};
use lab::sweep::outcome::{Outcome, TrialOutcome};
use lab::sweep::page;
use lab::sweep::record::Record;
use output::grouped;
use proto::layout::Dimensions;
use proto::{ExitCode, ExitError};
use run::precision;
use run::preflight::{self, Remedy, Verdict};
use run::robots::load_robot_of;
use run::signals::StopRequests;
use run::supervisor::Programs;
use serde_json::json;
use store::files;

use self::drive::{Drive, Ended};
use self::file::SweepFile;
pub use self::options::SweepArgs;
use self::place::Place;
use self::plan::Plan;
use self::slots::Slots;
use crate::planned_run::PlannedRun;

/// What a second request to stop says if something in this process does not end.
const ABANDONED: &str = "stopped at once; the same command goes on from the last checkpoints";

/// Does what is missing, and shows what has come of it.
pub fn run(args: &SweepArgs) -> anyhow::Result<()> {
    let place = Place::of(&args.file, args.out.as_deref());
    let plan = Plan::new(SweepFile::read(&args.file)?, &place.trials())?;
    place.check(&plan)?;
    let trials = plan.study.trials.len();
    let jobs = args.jobs.or(plan.file.jobs);
    if args.dry_run {
        check_machine(&plan)?;
        let slots = Slots::new(jobs, plan.processors, trials)?;
        return show(&plan, &slots, args.json);
    }
    if args.table {
        place.check_begun()?;
        return print(args, &place, &outcome(&plan, &place.records(&plan)));
    }
    let only = args.trial.map(|trial| trial - 1);
    if let Some(only) = only
        && only >= trials
    {
        let message = format!(
            "--trial {}: {} has {}",
            only + 1,
            args.file.display(),
            output::counted(trials as u64, "trial")
        );
        return Err(ExitError::new(ExitCode::Usage, message).into());
    }
    // What no trial could do without.
    Programs::find()?;
    check_disk(&plan)?;
    let name = only.map(|only| plan.study.trials[only].name.as_str());
    let held = place.open(&plan, name)?;
    let slots = match only {
        None => Slots::new(jobs, plan.processors, trials)?,
        Some(_) => Slots::new(Some(1), plan.processors, 1)?,
    };
    let stop = StopRequests::new();
    stop.listen_and_insist(ABANDONED).context("signals cannot be caught")?;
    let ended = Drive::new(&plan, &place, slots, only).run(&stop)?;
    let records = place.records(&plan);
    let outcome = outcome(&plan, &records);
    if only.is_none() {
        // Whatever there is is worth a look.
        files::replace(&place.table(), &outcome.csv()?)?;
        let title = args.file.file_stem().unwrap_or_default().to_string_lossy();
        let html = page::page(&title, &plan.study, &outcome)?;
        files::replace(&place.page(), html.as_bytes())?;
    }
    drop(held);
    if ended == Ended::Stopped {
        let message = format!("stopped; `{}` goes on", typed(&again(args, &place)));
        return Err(ExitError::new(ExitCode::Interrupted, message).into());
    }
    match only {
        None => print(args, &place, &outcome)?,
        Some(only) => print_trial(args, &outcome.trials[only])?,
    }
    let failed: Vec<&TrialOutcome> = match only {
        None => outcome.failed(),
        Some(only) => outcome
            .failed()
            .into_iter()
            .filter(|trial| trial.name == plan.study.trials[only].name)
            .collect(),
    };
    let Some(first) = failed.first() else { return Ok(()) };
    let is_damaged = |trial: &&&TrialOutcome| {
        let named = plan.study.trials.iter().zip(&records).find(|(own, _)| own.name == trial.name);
        named.is_some_and(|(_, record)| record.damaged)
    };
    // Others are tried again; this one waits for somebody.
    let damaged = failed.iter().find(is_damaged);
    let then = match damaged {
        None => "; the same command tries them again",
        Some(_) if plan.file.halving.is_some() => "; until then no rung is decided that it is at",
        Some(_) => "",
    };
    let first = damaged.unwrap_or(first);
    let message = format!(
        "{} of {} failed; {}: {}{then}",
        failed.len(),
        output::counted(trials as u64, "trial"),
        first.name,
        first.failure.as_deref().unwrap_or_default()
    );
    Err(ExitError::new(ExitCode::Failure, message).into())
}

/// What helps trials that their disk does not carry.
const REMEDY: Remedy = Remedy {
    elsewhere: "choose another --out",
    less: Some("set run.checkpoints_kept = 1 in [set]"),
    flags: &[],
};

/// Refuses a disk that has no room for the first trial that is still to begin.
fn check_disk(plan: &Plan) -> anyhow::Result<()> {
    let is_new = |run: &&PlannedRun| matches!(run.has_begun(), Ok(false));
    let Some(run) = plan.runs.iter().find(is_new) else { return Ok(()) };
    let config = run.config()?;
    let dimensions = Dimensions::new(&config, load_robot_of(&config)?.joints);
    let disk = preflight::disk(&run.dir, &config, &dimensions, 0, &REMEDY);
    if disk.verdict == Verdict::Failure {
        return Err(ExitError::new(ExitCode::RunDirectory, disk.sentence()).into());
    }
    Ok(())
}

/// Refuses what this machine cannot train, as `octopus train --dry-run` does: one trial for each device that is asked for.
fn check_machine(plan: &Plan) -> anyhow::Result<()> {
    let programs = Programs::find()?;
    let mut devices = BTreeSet::new();
    for (run, trial) in plan.runs.iter().zip(&plan.study.trials) {
        let config = precision::resolve(run.config()?);
        if !devices.insert(config.run.device.clone()) {
            continue;
        }
        let robot = load_robot_of(&config)?;
        let (run_dir, learner) = (run.run_dir(), &programs.learner);
        preflight::check_machine(&config, &robot, &run_dir, learner, None, &REMEDY).map_err(
            |error| ExitError::new(error.code, format!("trial {}: {error}", trial.name)),
        )?;
    }
    Ok(())
}

/// What has come of it so far. Who failed when last tried counts as failed.
fn outcome(plan: &Plan, records: &[Record]) -> Outcome {
    Outcome::of(&plan.study, records, |trial| records[trial].failure.is_some())
}

fn print(args: &SweepArgs, place: &Place, outcome: &Outcome) -> anyhow::Result<()> {
    if args.json {
        return output::json(&json!({
            "sweep": place.path(),
            "configurations": outcome.configurations,
            "trials": outcome.trials,
        }));
    }
    // Of the last time that it ended; none yet while it is under way for the first time.
    let files = [("trials", place.table()), ("report", place.page())]
        .into_iter()
        .filter(|(_, path)| path.is_file())
        .map(|(what, path)| format!("\n{what}  {}", path.display()));
    let files: String = files.collect();
    let gap = if files.is_empty() { "" } else { "\n" };
    output::line(&format!("{}{gap}{files}", outcome.table(output::columns())))
}

fn print_trial(args: &SweepArgs, trial: &TrialOutcome) -> anyhow::Result<()> {
    if args.json {
        return output::json(trial);
    }
    output::line(&output::table(Outcome::TRIALS, [trial.row()]))
}

/// The trials, and what they cost.
fn show(plan: &Plan, slots: &Slots, json: bool) -> anyhow::Result<()> {
    let study = &plan.study;
    let [all, most] = study.env_steps();
    if json {
        let trial = |(index, trial): (usize, &lab::sweep::study::Trial)| {
            json!({
                "trial": index + 1,
                "name": trial.name,
                "configuration": study.configurations[trial.configuration],
                "seed": trial.seed,
                "rungs": trial.rungs,
                "arguments": plan.runs[index].words,
            })
        };
        return output::json(&json!({
            "jobs": slots.count(),
            "env_steps": all,
            "env_steps_with_halving": most,
            "trials": study.trials.iter().enumerate().map(trial).collect::<Vec<_>>(),
        }));
    }
    let rows = study.trials.iter().enumerate().map(|(index, trial)| {
        let iterations: Vec<String> = trial.rungs.iter().map(|rung| grouped(*rung)).collect();
        let steps = trial.rungs.last().map_or(0, |last| last * trial.steps_per_iteration);
        let configuration = &study.configurations[trial.configuration];
        let cells = [configuration.clone(), (index + 1).to_string(), trial.seed.to_string()];
        let [configuration, number, seed] = cells;
        [configuration, number, seed, iterations.join(", "), grouped(steps)]
    });
    let header = ["configuration", "trial", "seed", "scored after", "env-steps"];
    let halving = match &plan.file.halving {
        None => String::new(),
        Some(_) => format!(", with halving {} at most", grouped(most)),
    };
    let apart = if slots.are_apart() { "each on its own" } else { "together on all" };
    output::line(&format!(
        "{}\n\n{} of {}; {} env-steps if all go to the end{halving}\n{} at a time, {apart} \
         processors; one keeps {} busy",
        output::table(header, rows),
        output::counted(study.trials.len() as u64, "trial"),
        output::counted(study.configurations.len() as u64, "configuration"),
        grouped(all),
        slots.count(),
        plan.processors,
    ))
}

/// The command that goes on.
fn again(args: &SweepArgs, place: &Place) -> Vec<std::ffi::OsString> {
    let mut words: Vec<std::ffi::OsString> =
        vec!["octopus".into(), "sweep".into(), args.file.clone().into()];
    words.push(path_option("--out", place.path()));
    words.extend(args.jobs.map(|jobs| option("--jobs", jobs)));
    words.extend(args.trial.map(|trial| option("--trial", trial)));
    words.extend(args.json.then(|| "--json".into()));
    words
}
