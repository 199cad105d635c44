//! `octopus resume`: a stopped run goes on as if it had never stopped.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use bucket::restore::{Restored, restore};
use bucket::{Bucket, BucketError};
use channels::Domain;
use clap::Args;
use proto::config::{Config, Precision};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use run::preflight::{self, Remedy};
use run::report::promised::Promised;
use run::start::bucket as start_bucket;
use run::start::directory::{RUNS, check_vacant, last_session, record};
use run::start::session::{Ended, Start, run_session};
use run::supervisor::Programs;
use run::{errors, precision, report, resume_point};
use store::budgets::{self, Budgets};
use store::checkpoint::{Checkpoint, CheckpointStore, Name};
use store::lock::RunLock;
use store::provenance::Provenance;
use store::recorded::Recorded;
use store::{files, outputs, temporary};

use crate::conclusion::{conclude, print_json, recorded_evaluation};
use crate::endpoint::HostArgs;
use crate::train;
use crate::training_options::{Ending, HttpArgs, Limits, Parent, Pause};
use crate::values::workers_if_any;

const RESUME_EXAMPLES: &str = "\
Examples:
  octopus resume runs/trajectory-20260101-120000
  octopus resume runs/trajectory-20260101-120000 --workers 4
  octopus resume runs/trajectory-20260101-120000 --env-steps 4e6
  octopus resume s3://bucket/prefix --run-dir runs/a

A bucket that a run has sent its checkpoints to (run.checkpoints) is enough to go on from it on \
another machine: the newest checkpoint there becomes a run directory first. \
--iterations, --env-steps and --pause-at are those of the whole run, not of what is left; --time-limit is \
that of this session. The number of workers changes nothing that is learned; another budget does \
when the learning rate falls over it.";

/// Options of `octopus resume`.
#[derive(Debug, Clone, Args)]
#[command(after_help = RESUME_EXAMPLES)]
pub struct ResumeArgs {
    /// The run directory, or the bucket of a run: s3://…, gs://…, az://…, file:///….
    #[arg(value_name = "RUN_DIR|BUCKET")]
    pub run: PathBuf,
    /// Where a run from a bucket lands; must not exist yet, or be empty [default: runs/PREFIX].
    #[arg(long, value_name = "DIR")]
    pub run_dir: Option<PathBuf>,
    /// Simulator processes, `auto` for one a processor; changes nothing that is learned.
    #[arg(long, value_name = "N|auto", allow_hyphen_values = true, value_parser = workers_if_any)]
    pub workers: Option<u64>,
    /// Refused: a run keeps its seed.
    #[arg(long, hide = true, value_name = "S", allow_hyphen_values = true, value_parser = no_seed)]
    pub seed: Option<String>,
    /// When to stop.
    #[command(flatten)]
    pub limits: Limits,
    /// Where to stop on the way.
    #[command(flatten)]
    pub pause: Pause,
    /// The run's HTTP service.
    #[command(flatten)]
    pub http: HttpArgs,
    /// Help from other machines.
    #[command(flatten)]
    pub hosts: HostArgs,
    /// What happens around the training.
    #[command(flatten)]
    pub ending: Ending,
    /// Who started it.
    #[command(flatten)]
    pub parent: Parent,
}

/// What helps an old run that this machine does not carry.
pub(crate) const REMEDY: Remedy = Remedy {
    elsewhere: "move the run directory to another disk",
    less: Some("lower run.checkpoints_kept in its config.toml"),
    flags: &["--workers"],
};

/// Whoever asks for a seed wants another training.
fn no_seed(seed: &str) -> Result<String, String> {
    let seed = output::quoted(seed);
    Err(format!("a run keeps its seed; `octopus train --seed {seed}` begins another one"))
}

/// Resumes, evaluates and says where everything is.
pub fn run(args: &ResumeArgs) -> anyhow::Result<()> {
    match resume(args)? {
        Resumed::Trained(ended) => conclude(&ended, args.ending),
        Resumed::Done(ended) if args.ending.json => {
            let evaluation = recorded_evaluation(&ended).filter(|_| !args.ending.no_eval);
            print_json(&ended, evaluation.as_ref())
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
    args.parent.tie()?;
    let place = restored(args)?;
    let run_dir = store::run_files::run_directory(place.as_deref().unwrap_or(&args.run))?;
    go_on(args, run_dir.clone()).map_err(|error| errors::name_what_goes_on(error, &run_dir))
}

/// Where the run of a bucket lies now, if the command names one.
fn restored(args: &ResumeArgs) -> anyhow::Result<Option<PathBuf>> {
    if !Bucket::is_named_by(&args.run) {
        return match &args.run_dir {
            Some(_) => Err(ExitError::new(
                ExitCode::Usage,
                "--run-dir is for a run from a bucket; one that is here goes on in its own directory",
            )
            .into()),
            None => Ok(None),
        };
    }
    let bucket = Bucket::open(&args.run.to_string_lossy()).map_err(BucketError::exit)?;
    let path = args.run_dir.clone().unwrap_or_else(|| Path::new(RUNS).join(bucket.name()));
    check_vacant(&path)?;
    outputs::check_outside("--run-dir", &path)?;
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).map_err(|error| {
            let message = format!("{}: cannot be created: {error}", parent.display());
            ExitError::new(ExitCode::RunDirectory, message)
        })?;
    }
    let Restored { name, passed_over, bytes } =
        restore(&bucket, &path).map_err(BucketError::exit)?;
    for passed in passed_over {
        output::note(&format!("warning: {passed}; going on from {name} instead"));
    }
    let (shown, size) = (path.display(), output::size(bytes));
    output::note(&format!("note: {name} of {} is in {shown} now ({size})", bucket.address()));
    Ok(Some(path))
}

fn go_on(args: &ResumeArgs, run_dir: RunDir) -> anyhow::Result<Resumed> {
    store::run_files::check_no_checkpoint(&run_dir, "octopus resume")?;
    train::check_service(&args.http)?;
    let domain = Domain::fresh();
    let lock = RunLock::acquire(&run_dir.lock(), domain.as_str())?;
    temporary::sweep(run_dir.path());

    let recorded = store::run_files::read_config(&run_dir)?;
    let (robot, robot_text) = store::run_files::read_robot(&run_dir)?;
    let mut budgets = Budgets::read(&run_dir)?;
    let resume = find_start(&run_dir, &recorded, &robot_text)?;
    let before = decided(&recorded, resume.as_ref())?;
    if let Some(checkpoint) = &resume {
        check_unchanged(&run_dir, &before, &robot_text, checkpoint)?;
    }
    if recorded.run.precision == Precision::Auto {
        output::note(&format!("note: {}", decision(before.run.precision, resume.is_some())));
    }

    note_budget(&run_dir, &budgets, &before);
    let (config, overrides) = override_limits(&before, args)?;
    let planned = config.planned_iterations();
    let pause_at = args.pause.pause_at.filter(|pause| *pause < planned);
    let wanted = pause_at.unwrap_or(planned);
    if let Some(last) = &resume
        && last.manifest.iteration >= wanted
    {
        let done = last.manifest.iteration;
        let (wanted, larger) = match pause_at {
            Some(pause) if done < planned => (pause, "--pause-at, or none,"),
            // No pause on the way was what ended it.
            _ => (planned, "--iterations or --env-steps"),
        };
        output::note(&format!(
            "note: nothing to do: {} {} done, {wanted} wanted; a larger {larger} goes on",
            output::counted(done, "iteration"),
            if done == 1 { "is" } else { "are" },
        ));
        let mirror = start_bucket::start(&config, &run_dir, &service::live::LiveRun::new())?;
        if let Some(note) = start_bucket::finish(mirror, &config, &run_dir, || true) {
            output::note(&note);
        }
        return Ok(Resumed::Done(Ended::before(run_dir, last)));
    }
    for change in &overrides {
        output::note(&format!("note: {change}"));
    }

    start_bucket::check(&config)?;
    let programs = Programs::find()?;
    let gateway = args.hosts.gateway()?;
    preflight::check_machine(
        &config,
        &robot,
        &run_dir,
        &programs.learner,
        gateway.as_ref(),
        &REMEDY,
    )?;
    let service = args.http.open(&run_dir)?;
    let provenance = Provenance::gather();
    if let Some(changes) =
        last_session(&run_dir)?.and_then(|before| provenance.changes_since(&before))
    {
        output::note(&format!(
            "note: this session may compute other bits than the last one: {changes}"
        ));
    }
    if budgets.last().is_none() {
        // A run from before they were written down.
        let then = resume.as_ref().map_or(&before, |checkpoint| &checkpoint.config);
        budgets.begin(0, then.run.env_steps)?;
    }
    if resume.is_none() {
        // What an undecided arithmetic came to, or another budget, is nothing to compare with.
        let repeats = budgets.repeat(&config, 0) && recorded.run.precision != Precision::Auto;
        note_beginning(&run_dir, repeats)?;
    }
    if recorded.run.precision == Precision::Auto && resume.is_none() {
        // What was computed in before the first checkpoint is not known, so that nothing is promised.
        report::forget(&run_dir)?;
    }
    if config != recorded {
        files::replace(&run_dir.config(), config.to_toml().as_bytes())?;
    }
    record(&run_dir, &provenance, &overrides)?;
    std::fs::create_dir_all(run_dir.logs()).map_err(|error| {
        ExitError::new(
            ExitCode::RunDirectory,
            format!("{}: cannot be created: {error}", run_dir.logs().display()),
        )
    })?;
    let start = Start {
        run_dir,
        config,
        robot,
        resume,
        programs,
        gateway,
        domain,
        provenance,
        service,
        pause_at,
    };
    run_session(start, lock, args.ending.quiet).map(Resumed::Trained)
}

/// The configuration with a precision that is decided. A run of an earlier version has `auto` in its `config.toml`: its
/// training state knows what that was, and where there is none the processor decides, as of a new run.
fn decided(config: &Config, checkpoint: Option<&Checkpoint>) -> anyhow::Result<Config> {
    let mut config = config.clone();
    if config.run.precision == Precision::Auto
        && let Some(checkpoint) = checkpoint
    {
        config.run.precision = checkpoint.precision()?;
    }
    Ok(precision::resolve(config))
}

/// Says what has become of an `auto` that an earlier version left.
fn decision(precision: Precision, recorded: bool) -> String {
    let name = precision::name(precision);
    if recorded {
        format!("run.precision is now {name}, as its checkpoints were trained; it was auto")
    } else {
        format!(
            "run.precision is now {name}, by this processor; it was auto, and what it computed in before is \
             not recorded, so that its digests may be others than those of before"
        )
    }
}

/// The newest checkpoint that is the run's own; none if it starts anew.
///
/// The metrics reach every one: a checkpoint is committed after its lines are durable. Only where a file
/// was lost or cut by other means does the run go further back, so that no iteration is left out.
fn find_start(
    run_dir: &RunDir,
    config: &Config,
    robot_toml: &str,
) -> anyhow::Result<Option<Checkpoint>> {
    let store = CheckpointStore::new(run_dir.checkpoints());
    let recorded = Recorded::read(run_dir)?;
    let mut promised = Promised::read(run_dir)?;
    promised.agree(&recorded)?;
    let search = resume_point::find(&store, run_dir, &BTreeMap::new())?;
    // What the metrics have lost is known all the same, if it is the run's.
    let mut unreached =
        search.passed_over.iter().filter(|passed| passed.unreached && !passed.imported);
    let lost = unreached.find_map(|passed| {
        let newest = store.load(&passed.dir).ok()?;
        promises(&store, run_dir, config, robot_toml, &newest).then_some(newest)
    });
    let (base, said) = search.settle(run_dir)?;
    for sentence in said {
        output::note(&format!("warning: {sentence}"));
    }
    if let (Some(_), Some(newest)) = (&base, lost) {
        promised.add([(newest.manifest.iteration - 1, newest.manifest.digest)])?;
    }
    Ok(base)
}

/// Whether a checkpoint that the metrics do not reach says what an iteration of this run must end with.
/// Nothing recorded ties it to the run, so it has to be one of the same configuration and whole, down to
/// the digest in its manifest.
fn promises(
    store: &CheckpointStore,
    run_dir: &RunDir,
    config: &Config,
    robot_toml: &str,
    newest: &Checkpoint,
) -> bool {
    let same_budget =
        !budgets::matters(config) || newest.config.run.env_steps == config.run.env_steps;
    let unchanged = decided(config, Some(newest))
        .and_then(|config| check_unchanged(run_dir, &config, robot_toml, newest));
    let name = Name::of_iteration(newest.manifest.iteration);
    let is_whole = || store.verify(&name).is_ok_and(|found| found.is_whole());
    same_budget && unchanged.is_ok() && newest.dir == store.dir(&name) && is_whole()
}

/// Says that a run without a checkpoint begins again, and whether what it has recorded must come out once more.
fn note_beginning(run_dir: &RunDir, repeats: bool) -> anyhow::Result<()> {
    let is_there = match (Recorded::read(run_dir)?.iterations(), repeats) {
        (0, _) => "no iteration is recorded".to_owned(),
        (1, true) => "one iteration is recorded, which must end as it did".to_owned(),
        (n, true) => format!("{n} iterations are recorded, which must end as they did"),
        (n, false) => {
            let recorded = output::counted(n, "recorded iteration");
            format!("what is trained now is not compared with {recorded}")
        }
    };
    output::note(&format!(
        "note: {}: holds no checkpoint to go on from; the run starts from the beginning ({is_there})",
        run_dir.checkpoints().display()
    ));
    Ok(())
}

/// Says so if the budget in `config.toml` is another than that of the iterations so far.
fn note_budget(run_dir: &RunDir, budgets: &Budgets, before: &Config) {
    if let Some(last) = budgets.last()
        && last.env_steps != before.run.env_steps
    {
        output::note(&format!(
            "note: {}: run.env_steps is {}, and was {} for the iterations so far, as {} says: one of \
             the two was changed by hand, or a resume that changes it was cut short",
            run_dir.config().display(),
            before.run.env_steps,
            last.env_steps,
            budgets.path().display()
        ));
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
) -> anyhow::Result<()> {
    let refuse = |path: &Path, what: &str| {
        Err(ExitError::new(
            ExitCode::RunDirectory,
            format!(
                "{}: {what} since checkpoint {}; put it back (the checkpoint holds a copy), or start \
                 another run with `octopus train --config`",
                path.display(),
                checkpoint.dir.display()
            ),
        )
        .into())
    };
    let then = &checkpoint.config;
    // Also by the checkpoints of a version that left `auto` undecided.
    let mut then_run = then.run.clone();
    then_run.precision = checkpoint.precision()?;
    let groups = [
        ("task", config.task == then.task),
        ("robot", config.robot == then.robot),
        ("env", config.env == then.env),
        ("network", config.network == then.network),
        ("algorithm", config.algorithm == then.algorithm),
        ("optimizer", config.optimizer == then.optimizer),
        ("run", config.run.continues(&then_run)),
    ];
    if let Some((group, _)) = groups.iter().find(|(_, same)| !same) {
        return refuse(&run_dir.config(), &format!("group `{group}` was changed"));
    }
    if robot_toml != checkpoint.robot_toml {
        return refuse(&run_dir.robot(), "was changed");
    }
    Ok(())
}
