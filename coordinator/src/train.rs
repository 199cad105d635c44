//! `octopus train`: from a command line to an evaluated policy.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::Context as _;
use channels::Domain;
use clap::Args;
use lab::evaluation::{self, Summary};
use output::grouped;
use proto::config::{AlgorithmName, Config, Layers, Preset, TaskName};
use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use run::preflight::{self, Remedy};
use run::report::divergence::{CURE, Divergence};
use run::report::{Diverged, Reporter};
use run::session::{self, Outcome, SessionSpec, StoppedBy};
use run::signals::StopRequests;
use run::supervisor::Programs;
use run::{errors, precision};
use serde_json::json;
use service::http::{OwnToken, Service, ServiceSpec, TOKEN_FILE, Token};
use service::live::LiveRun;
use simulator::env::step_options;
use simulator::evaluate::EvaluationOptions;
use simulator::robot::Robot;
use store::checkpoint::{Checkpoint, CheckpointStore};
use store::lock::RunLock;
use store::provenance::{self, Provenance};
use store::{files, outputs, regular};

use crate::names::Named;
use crate::training_options::{Ending, HttpArgs, Limits, Listen};
use crate::values::{assignment, whole, workers};

const TRAIN_EXAMPLES: &str = "\
Examples:
  octopus train
  octopus train reorientation --time-limit 10m
  octopus train --preset paper --seed 7 --run-dir runs/paper-7
  octopus train --preset paper --algorithm ppo
  octopus train --set network.hidden=[64,64] --set algorithm.gamma=0.97 \\
      --iterations 20

Configuration is merged in layers, later ones win: the preset, --config, the flags above, --set. \
Its groups are task, robot, env, network, algorithm, optimizer and run; the resolved whole is \
written to RUN_DIR/config.toml. One Ctrl-C finishes the iteration, commits a checkpoint and ends \
cleanly; a second one stops at once. `octopus resume RUN_DIR` goes on.";

/// Options of `octopus train`.
#[derive(Debug, Clone, Args)]
#[command(after_help = TRAIN_EXAMPLES)]
pub struct TrainArgs {
    /// The task [default: trajectory, unless --config says otherwise].
    #[arg(value_enum)]
    pub task: Option<Named<TaskName>>,
    /// The configuration to start from.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = Named(Preset::Tuned))]
    pub preset: Named<Preset>,
    /// A TOML file with the keys to change.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The learning algorithm, with what the preset changes for it [default: mappo, unless --config says
    /// otherwise].
    #[arg(long, allow_negative_numbers = true, value_name = "NAME", value_enum)]
    pub algorithm: Option<Named<AlgorithmName>>,
    /// Change one key; may be given again: --set algorithm.gamma=0.97.
    #[arg(long = "set", value_name = "KEY=VALUE", allow_hyphen_values = true, value_parser = assignment)]
    pub sets: Vec<String>,
    /// Simulator processes, `auto` for one a processor; changes nothing that is learned.
    #[arg(long, value_name = "N|auto", allow_hyphen_values = true, value_parser = workers)]
    pub workers: Option<u64>,
    /// Fix each worker to a processor.
    #[arg(long)]
    pub pin: bool,
    /// Environments of the whole run, one episode each per iteration.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u64>(1, u64::MAX))]
    pub envs: Option<u64>,
    /// Seed of every random number.
    #[arg(long, value_name = "S", allow_hyphen_values = true, value_parser = whole::<u64>(0, i64::MAX as u64))]
    pub seed: Option<u64>,
    /// When to stop.
    #[command(flatten)]
    pub limits: Limits,
    /// Where results land; must not exist yet, or be empty [default: runs/TASK-TIME].
    #[arg(long, value_name = "DIR")]
    pub run_dir: Option<PathBuf>,
    /// 1 rolls out the next iteration while the learner trains on this one.
    #[arg(long, value_name = "0|1", allow_hyphen_values = true, value_parser = whole::<u64>(0, 1))]
    pub overlap: Option<u64>,
    /// Where the learner computes: cpu, cuda:0.
    #[arg(long, allow_negative_numbers = true, value_name = "DEVICE")]
    pub device: Option<String>,
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// The run's HTTP service.
    #[command(flatten)]
    pub http: HttpArgs,
    /// Check what is asked for, print the whole configuration as TOML (or JSON), and train nothing.
    #[arg(long)]
    pub dry_run: bool,
    /// What happens around the training.
    #[command(flatten)]
    pub ending: Ending,
    /// The process that started this one and that it shall not outlive.
    #[arg(long, value_name = "PID", hide = true)]
    pub parent: Option<i32>,
}

/// Where runs land without `--run-dir`.
pub(super) const RUNS: &str = "runs";

/// Trains, evaluates and says where everything is.
pub fn run(args: &TrainArgs) -> anyhow::Result<()> {
    if args.dry_run { show(args) } else { train(args)?.conclude(args.ending) }
}

/// What would be trained, if it can be.
struct Plan {
    config: Config,
    robot: Robot,
    programs: Programs,
}

/// Everything that is asked for, checked, but for the address of the service; nothing is written.
fn plan(args: &TrainArgs) -> anyhow::Result<Plan> {
    let config = precision::resolve(configure(args)?);
    check_token_file(&args.http)?;
    let robot = run::robots::load_fit_robot(&config.robot.description, &step_options(&config))?;
    match &args.run_dir {
        Some(path) => {
            check_vacant(path)?;
            outputs::check_outside("--run-dir", path)?;
        }
        None => outputs::check_outside("--run-dir", &Path::new(RUNS).join("new"))?,
    }
    let programs = Programs::find()?;
    let place = args.run_dir.as_deref().unwrap_or(Path::new(RUNS));
    preflight::check_machine(&config, &robot, &RunDir::new(place), &programs.learner, &REMEDY)?;
    Ok(Plan { config, robot, programs })
}

/// Prints the configuration of a training that could start.
fn show(args: &TrainArgs) -> anyhow::Result<()> {
    let config = plan(args)?.config;
    if args.ending.json {
        return output::json(&config);
    }
    output::line(config.to_toml().trim_end())
}

/// Trains.
pub(super) fn train(args: &TrainArgs) -> anyhow::Result<Ended> {
    if args.parent.is_some() {
        process::child::die_with_parent(args.parent)?;
    }
    let Plan { config, robot, programs } = plan(args)?;
    let (run_dir, counter) = open(args, &config)?;

    create(&run_dir)?;
    let domain = Domain::fresh();
    let lock = RunLock::acquire(&run_dir.lock(), domain.as_str())?;
    let provenance = Provenance::gather();
    files::replace(&run_dir.robot(), robot.to_toml().as_bytes())?;
    files::replace(&run_dir.config(), config.to_toml().as_bytes())?;
    record(&run_dir, &provenance, &[])?;
    let (resume, dir) = (None, run_dir.clone());
    let start = Start { run_dir, config, robot, resume, programs, domain, provenance, counter };
    run_session(start, lock, args.ending.quiet)
        .map_err(|error| errors::name_what_goes_on(error, &dir))
}

/// What helps a new run that its disk does not carry.
pub(crate) const REMEDY: Remedy = Remedy {
    elsewhere: "choose another --run-dir",
    less: Some("--set run.checkpoints_kept=1"),
    flags: &["--workers", "--envs"],
};

/// The run directory and the counter that belongs to it. A directory of our own choice is made here, so
/// that no other run chooses it, and is gone again if there is no counter.
fn open(args: &TrainArgs, config: &Config) -> anyhow::Result<(RunDir, Counter)> {
    let chosen = args.run_dir.is_none();
    let run_dir = match &args.run_dir {
        Some(path) => RunDir::new(path),
        None => claim(Path::new(RUNS), &default_name(config))?,
    };
    match Counter::open(&args.http, &run_dir) {
        Ok(counter) => Ok((run_dir, counter)),
        Err(error) => {
            if chosen {
                // The error above is the one to report; an empty directory is no harm.
                let _ = std::fs::remove_dir(run_dir.path());
            }
            Err(error)
        }
    }
}

/// What a session starts from, of a new run or of an old one.
pub(super) struct Start {
    pub(super) run_dir: RunDir,
    pub(super) config: Config,
    pub(super) robot: Robot,
    pub(super) resume: Option<Checkpoint>,
    pub(super) programs: Programs,
    pub(super) domain: Domain,
    pub(super) provenance: Provenance,
    pub(super) counter: Counter,
}

/// Where others see the run and ask it for something: its HTTP service, if it is to have one.
///
/// Opened before a run writes any file, so that an address or a token that is wrong leaves nothing.
pub(super) struct Counter {
    live: LiveRun,
    desk: Option<Desk>,
}

/// A service, and the token of its own.
struct Desk {
    service: Service,
    token: OwnToken,
}

impl Counter {
    /// Begins to listen.
    pub(super) fn open(args: &HttpArgs, run_dir: &RunDir) -> anyhow::Result<Self> {
        let live = LiveRun::new();
        let Listen::At(address) = args.listen else { return Ok(Self { live, desk: None }) };
        let token = Token::find(args.token_file.as_deref())?;
        let own = OwnToken::prepare(run_dir.path().join(TOKEN_FILE))?;
        let store = CheckpointStore::new(run_dir.checkpoints());
        let spec = ServiceSpec::new(store, own.token());
        let spec = ServiceSpec { address, token, live: Some(live.clone()), ..spec };
        Ok(Self { live, desk: Some(Desk { service: Service::start(spec)?, token: own }) })
    }
}

/// A session that has ended.
pub(super) struct Ended {
    run_dir: RunDir,
    outcome: Outcome,
    stop: StopRequests,
}

/// Runs a session to its end.
pub(super) fn run_session(start: Start, mut lock: RunLock, quiet: bool) -> anyhow::Result<Ended> {
    let Start { run_dir, config, robot, resume, programs, domain, provenance, counter } = start;
    let stop = StopRequests::new();
    stop.listen_and_insist(ABANDONED).context("signals cannot be caught")?;
    let resume_from = resume.as_ref().map(|checkpoint| checkpoint.manifest.iteration);
    let mut reporter = Reporter::create(&run_dir, &config, resume_from, quiet)?;
    if !quiet {
        reporter.note(&introduction(&config, &run_dir, resume_from));
    }
    if let Some(note) = idle_workers(&config) {
        reporter.note(&note);
    }
    let Counter { live, mut desk } = counter;
    if let Some(Desk { service, token }) = &mut desk {
        // Whoever reads the address finds the token.
        token.keep()?;
        lock.announce(&service.address().to_string())
            .with_context(|| format!("{}: cannot be written", run_dir.lock().display()))?;
    }
    let spec = SessionSpec {
        run_dir: run_dir.clone(),
        config,
        robot,
        resume,
        programs,
        provenance: serde_json::to_value(provenance).context("provenance has no JSON form")?,
        domain,
        stop: stop.clone(),
        until: None,
        live,
    };
    let result = session::run(&spec, &mut reporter);
    if let Some(Desk { service, .. }) = desk {
        service.stop();
    }
    // Also after a failure: what was measured until then is worth keeping.
    let finished = reporter.finish();
    let outcome = result?;
    finished?;
    Ok(Ended { run_dir, outcome, stop })
}

/// What a second request to stop says if something in this process does not end.
pub(super) const ABANDONED: &str = "stopped at once; what was being written is abandoned; `octopus resume` goes on from the last \
     checkpoint, if there is one";

fn introduction(config: &Config, run_dir: &RunDir, resume_from: Option<u64>) -> String {
    let task = config.task.name.as_str();
    let planned = config.planned_iterations();
    let what = match resume_from {
        Some(iteration) => format!("{task}: iterations {iteration} to {planned}"),
        None => format!("{task}: {}", output::counted(planned, "iteration")),
    };
    let workers = config.run.workers;
    format!(
        "{what} of {} env-steps, {workers} worker{}, in {}",
        grouped(config.steps_per_iteration()),
        if workers == 1 { "" } else { "s" },
        run_dir.path().display()
    )
}

impl Ended {
    /// Of a run that was at its end already, with its last checkpoint.
    pub(super) fn before(run_dir: RunDir, last: &Checkpoint) -> Self {
        let outcome = Outcome {
            iterations: last.manifest.iteration,
            env_steps: last.manifest.env_steps,
            stopped_by: StoppedBy::Budget,
            checkpoint: last.dir.clone(),
        };
        Self { run_dir, outcome, stop: StopRequests::new() }
    }

    /// Whether anybody asked it to stop, also where it was about to end anyway.
    pub(super) fn was_interrupted(&self) -> bool {
        self.stop.count() > 0
    }

    /// The evaluation of its last checkpoint that lies in the run directory, if there is one.
    pub(super) fn recorded_evaluation(&self) -> Option<Summary> {
        let bytes = regular::read(&evaluation_path(&self.run_dir), regular::RECORD).ok()?;
        let summary: Summary = serde_json::from_slice(&bytes).ok()?;
        (summary.iteration == self.outcome.iterations).then_some(summary)
    }

    /// The learning curve, if it was drawn.
    fn curve(&self) -> Option<PathBuf> {
        Some(self.run_dir.curve()).filter(|curve| curve.is_file())
    }

    /// Where the training has diverged, unless it has recovered.
    fn divergence(&self) -> anyhow::Result<Option<Diverged>> {
        Ok(Divergence::recorded(&self.run_dir)?.found().cloned())
    }

    /// How it ended, in a word or two.
    fn stopped_by(&self) -> &'static str {
        match self.outcome.stopped_by {
            StoppedBy::Budget => "budget",
            StoppedBy::TimeLimit => "time limit",
            StoppedBy::Signal => "signal",
        }
    }

    /// Prints the result as JSON.
    pub(super) fn print_json(&self, evaluation: Option<&Summary>) -> anyhow::Result<()> {
        output::json(&json!({
            "run_dir": self.run_dir.path(),
            "iterations": self.outcome.iterations,
            "env_steps": self.outcome.env_steps,
            "stopped_by": self.stopped_by(),
            "checkpoint": self.outcome.checkpoint,
            "curve": self.curve(),
            "divergence": self.divergence()?,
            "evaluation": evaluation,
        }))
    }

    /// Evaluates the final policy and prints what a person wants to know next.
    pub(super) fn conclude(self, ending: Ending) -> anyhow::Result<()> {
        let Self { run_dir, outcome, stop } = &self;
        let evaluation = if ending.no_eval || outcome.stopped_by == StoppedBy::Signal {
            None
        } else {
            let checkpoint =
                CheckpointStore::new(run_dir.checkpoints()).load(&outcome.checkpoint)?;
            let summary = evaluate(checkpoint, stop)?;
            let text =
                serde_json::to_vec_pretty(&summary).context("the evaluation has no JSON form")?;
            files::replace(&evaluation_path(run_dir), &text)?;
            Some(summary)
        };
        if ending.json {
            return self.print_json(evaluation.as_ref());
        }
        output::line(&format!(
            "{}, {} env-steps, ended by the {}",
            output::counted(outcome.iterations, "iteration"),
            grouped(outcome.env_steps),
            self.stopped_by()
        ))?;
        if let Some(diverged) = self.divergence()? {
            output::line(&format!("warning: {diverged}; {CURE}"))?;
        }
        if let Some(evaluation) = &evaluation {
            output::line(&format!("\n{}\n", evaluation.table(output::columns(), ending.agents)))?;
            output::line(&format!("evaluation  {}", evaluation_path(run_dir).display()))?;
        }
        if let Some(curve) = self.curve() {
            output::line(&format!("curve       {}", curve.display()))?;
        }
        output::line(&format!("checkpoint  {}", outcome.checkpoint.display()))?;
        if outcome.stopped_by != StoppedBy::Budget {
            output::line(&format!("go on with  octopus resume {}", run_dir.path().display()))?;
        }
        Ok(())
    }
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
                format!("evaluation stopped; `octopus eval {}` repeats it", dir.display());
            return Err(ExitError::new(ExitCode::Interrupted, message).into());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    evaluation.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn evaluation_path(run_dir: &RunDir) -> PathBuf {
    run_dir.path().join("evaluation.json")
}

/// The configuration that the command line asks for. An error about a key that a flag has set
/// names the flag.
pub(super) fn configure(args: &TrainArgs) -> Result<Config, ExitError> {
    resolve(args).map_err(|error| {
        let flag = match &error {
            ConfigError::Invalid { key, .. } => {
                flags(args).into_iter().find(|flag| flag.key() == *key)
            }
            _ => None,
        };
        let message = match flag {
            Some(flag) => format!("{}: {error}", flag.origin),
            None => error.to_string(),
        };
        ExitError::new(ExitCode::BadInput, message)
    })
}

/// A flag that sets a key.
struct Flag {
    origin: String,
    group: &'static str,
    name: &'static str,
    value: toml::Value,
}

impl Flag {
    fn key(&self) -> String {
        format!("{}.{}", self.group, self.name)
    }
}

/// The flags of the command line that set keys.
fn flags(args: &TrainArgs) -> Vec<Flag> {
    let mut flags = Vec::new();
    let mut add = |flag: &str, group, name, value: Option<toml::Value>| {
        if let Some(value) = value {
            let shown = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            flags.push(Flag { origin: format!("{flag} {shown}"), group, name, value });
        }
    };
    let integer = |value: Option<u64>| value.map(|value| (value as i64).into());
    let text = |value: &Option<String>| value.clone().map(toml::Value::String);
    let limit = args.limits.time_limit.map(|limit| limit.as_secs_f64().into());
    let algorithm = args.algorithm.map(|Named(algorithm)| algorithm.as_str().to_owned());
    let algorithm = text(&algorithm);
    add("--workers", "run", "workers", integer(args.workers));
    add("--pin", "run", "pin", args.pin.then_some(true.into()));
    add("--seed", "run", "seed", integer(args.seed));
    add("--overlap", "run", "overlap", integer(args.overlap));
    add("--env-steps", "run", "env_steps", integer(args.limits.env_steps));
    add("--time-limit", "run", "time_limit_s", limit);
    add("--device", "run", "device", text(&args.device));
    add("--algorithm", "algorithm", "name", algorithm);
    add("--envs", "env", "n_envs", integer(args.envs));
    add("--robot", "robot", "description", text(&args.robot));
    flags
}

/// Merges the layers of the command line.
fn resolve(args: &TrainArgs) -> Result<Config, ConfigError> {
    let mut layers = Layers::new(args.preset.0, args.task.map(|task| task.0));
    if let Some(path) = &args.config {
        let text = regular::read_text(path, regular::TEXT)
            .map_err(|source| ConfigError::Read { path: path.clone(), source })?;
        layers = layers.text(&text, &path.display().to_string())?;
    }
    for flag in flags(args) {
        let text = format!("[{}]\n{} = {}", flag.group, flag.name, flag.value);
        layers = layers.text(&text, &flag.origin)?;
    }
    for assignment in &args.sets {
        layers = layers.set(assignment)?;
    }
    let mut config = match (layers.resolve(), args.envs) {
        // --envs alone shall not ask for a number of shards: the nearest smaller one that fits.
        (Err(ConfigError::Invalid { key: "env.n_shards", .. }), Some(n_envs))
            if !sets(args, "env.n_shards") =>
        {
            let text = format!("[env]\nn_shards = {}", fitting_shards(args, n_envs)?);
            layers.text(&text, &format!("--envs {n_envs}"))?.resolve()?
        }
        (result, _) => result?,
    };
    if let Some(iterations) = args.limits.iterations {
        config.run.env_steps = iterations.saturating_mul(config.steps_per_iteration());
        config.validate()?;
    }
    Ok(config)
}

/// The largest number of shards up to the configured one that divides `n_envs`.
fn fitting_shards(args: &TrainArgs, n_envs: u64) -> Result<u64, ConfigError> {
    let plain = TrainArgs { envs: None, ..args.clone() };
    let wanted = resolve(&plain)?.env.n_shards as u64;
    let largest = wanted.min(n_envs);
    Ok((1..=largest).rev().find(|shards| n_envs.is_multiple_of(*shards)).unwrap_or(1))
}

fn sets(args: &TrainArgs, key: &str) -> bool {
    args.sets.iter().any(|set| set.split('=').next().is_some_and(|name| name.trim() == key))
}

/// Says so if there are more workers than an iteration has shards.
fn idle_workers(config: &Config) -> Option<String> {
    let (workers, shards) = (config.run.workers, config.env.n_shards);
    (workers > shards).then(|| {
        format!(
            "note: an iteration has {}, so that {} of the {workers} workers will be idle; \
             --envs N --set env.n_shards={workers} makes work for all, and another training",
            output::counted(shards as u64, "shard"),
            workers - shards
        )
    })
}

/// Refuses a token file that is none, also where no service would ask for the token.
pub(super) fn check_token_file(args: &HttpArgs) -> Result<(), ExitError> {
    match &args.token_file {
        Some(path) => Token::find(Some(path)).map(drop),
        None => Ok(()),
    }
}

/// Refuses a run directory with anything in it.
fn check_vacant(path: &Path) -> Result<(), ExitError> {
    let shown = path.display();
    let refuse = |message: String| Err(ExitError::new(ExitCode::RunDirectory, message));
    match std::fs::read_dir(path).map(|mut entries| entries.next().is_none()) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(error) => {
            refuse(format!("{shown}: cannot be a run directory: {error}; choose another --run-dir"))
        }
        Ok(true) => Ok(()),
        Ok(false) if RunDir::new(path).config().is_file() => refuse(format!(
            "{shown}: holds a run already; go on with it by `octopus resume {shown}`, or choose \
             another --run-dir"
        )),
        Ok(false) => refuse(format!("{shown}: is not empty; choose another --run-dir")),
    }
}

/// Makes the directory and its folders.
fn create(run_dir: &RunDir) -> Result<(), ExitError> {
    for path in [run_dir.path().to_owned(), run_dir.logs(), run_dir.checkpoints()] {
        std::fs::create_dir_all(&path).map_err(|error| {
            ExitError::new(
                ExitCode::RunDirectory,
                format!("{}: cannot be created: {error}; choose another --run-dir", path.display()),
            )
        })?;
    }
    Ok(())
}

/// `<task>-<UTC time>`.
fn default_name(config: &Config) -> String {
    let time = provenance::utc(SystemTime::now()).compact();
    format!("{}-{time}", config.task.name.as_str())
}

/// Makes the directory `name` in `parent`, with a number if another run has that name: making it is what
/// tells who was first, of runs that start in the same second.
fn claim(parent: &Path, name: &str) -> Result<RunDir, ExitError> {
    let fail = |path: &Path, error: std::io::Error| {
        let shown = path.display();
        let message =
            format!("{shown}: cannot be created: {error}; choose another place by --run-dir");
        ExitError::new(ExitCode::RunDirectory, message)
    };
    std::fs::create_dir_all(parent).map_err(|error| fail(parent, error))?;
    let mut path = parent.join(name);
    let mut n = 1;
    loop {
        match std::fs::create_dir(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                n += 1;
                path = parent.join(format!("{name}-{n}"));
            }
            made => return made.map(|()| RunDir::new(&path)).map_err(|error| fail(&path, error)),
        }
    }
}

/// Adds a session to `provenance.json`.
pub(super) fn record(
    run_dir: &RunDir,
    provenance: &Provenance,
    overrides: &[String],
) -> anyhow::Result<()> {
    let path = run_dir.provenance();
    let mut sessions: Vec<serde_json::Value> = regular::read(&path, regular::RECORD)
        .ok()
        .and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok())
        .and_then(|document| document["sessions"].as_array().cloned())
        .unwrap_or_default();
    let mut session = serde_json::to_value(provenance).context("provenance has no JSON form")?;
    session["overrides"] = json!(overrides);
    sessions.push(session);
    let text = serde_json::to_vec_pretty(&json!({ "sessions": sessions }))
        .context("provenance has no JSON form")?;
    files::replace(&path, &text)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::{Cli, Command};

    fn parse(line: &str) -> Result<Config, ExitError> {
        let cli = Cli::try_parse_from(line.split(' ')).expect("a valid command line");
        let Command::Train(args) = cli.command else { panic!("not train") };
        configure(&args)
    }

    #[test]
    fn flags_are_layers_over_the_preset() {
        let config = parse("octopus train reorientation --workers 3 --seed 9 --time-limit 10m")
            .expect("valid");
        assert_eq!(config.task.name.as_str(), "reorientation");
        assert_eq!((config.run.workers, config.run.seed), (3, 9));
        assert_eq!(config.run.time_limit_s, 600.0);
        for name in AlgorithmName::ALL {
            let config = parse(&format!("octopus train --algorithm {}", name.as_str()));
            assert_eq!(config.expect("valid").algorithm.name, name);
        }
        let config = parse("octopus train --iterations 3 --set env.n_envs=64").expect("valid");
        assert_eq!(config.planned_iterations(), 3);
        assert_eq!(config.run.env_steps, 3 * 64 * config.task.episode_steps as u64);
    }

    #[test]
    fn a_number_of_environments_brings_a_number_of_shards_that_divides_it() {
        for n_envs in [1_usize, 7, 12, 100, 255, 1000] {
            let config = parse(&format!("octopus train --envs {n_envs}")).expect("valid");
            assert_eq!(config.env.n_envs, n_envs);
            assert_eq!(n_envs % config.env.n_shards, 0);
        }
        let error = parse("octopus train --envs 10 --set env.n_shards=3").expect_err("impossible");
        assert!(error.to_string().contains("env.n_shards"), "{error}");
    }

    #[test]
    fn more_workers_than_shards_are_said_to_be_idle() {
        let five = parse("octopus train --workers 5 --set env.n_shards=4").expect("valid");
        let note = idle_workers(&five).expect("one is idle");
        assert!(note.contains("4 shards, so that 1 of the 5 workers"), "{note}");
        let four = parse("octopus train --workers 4 --set env.n_shards=4").expect("valid");
        assert_eq!(idle_workers(&four), None);
    }

    #[test]
    fn runs_that_start_in_the_same_second_get_directories_of_their_own() {
        let dir = tempfile::tempdir().expect("tempdir");
        let parent = dir.path().join("runs");
        let names: std::collections::BTreeSet<_> = std::thread::scope(|scope| {
            let starts: Vec<_> = (0..8).map(|_| scope.spawn(|| claim(&parent, "x"))).collect();
            let claimed = starts.into_iter().map(|start| start.join().expect("no panic"));
            claimed.map(|run_dir| run_dir.expect("writable").path().to_owned()).collect()
        });
        let expected = ["x", "x-2", "x-3", "x-4", "x-5", "x-6", "x-7", "x-8"];
        assert_eq!(names, expected.map(|name| parent.join(name)).into());
    }

    #[test]
    fn errors_name_the_flag() {
        let error = parse("octopus train --set algorithm.gama=0.9").expect_err("unknown");
        assert_eq!(
            error.to_string(),
            "--set algorithm.gama=0.9: unknown key `algorithm.gama`; did you mean `gamma`?"
        );
        let error = parse("octopus train --algorithm ippo --set network.critic_state=compact")
            .expect_err("a contradiction")
            .to_string();
        assert!(error.contains("network.critic_state"), "{error}");
        let error = parse("octopus train --device tpu").expect_err("no device").to_string();
        assert!(error.starts_with("--device tpu: ") && error.contains("cuda:0"), "{error}");
    }
}
