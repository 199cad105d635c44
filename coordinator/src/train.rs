//! `octopus train`: from a command line to an evaluated policy.

use std::path::{Path, PathBuf};

use channels::Domain;
use clap::Args;
use proto::config::{AlgorithmName, Config, Layers, Preset, TaskName};
use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use run::preflight::{self, Remedy};
use run::start::bucket;
use run::start::directory::{
    RUNS, check_new, check_still_new, claim, create, default_name, record,
};
use run::start::service::RunService;
use run::start::session::{Ended, Start, run_session};
use run::supervisor::{GatewaySpec, Programs};
use run::{errors, precision};
use service::http::{Token, check_address};
use simulator::robot::Robot;
use store::lock::RunLock;
use store::provenance::Provenance;
use store::{files, outputs, regular_files};

use crate::conclusion::conclude;
use crate::endpoint::HostArgs;
use crate::names::Named;
use crate::training_options::{Ending, HttpArgs, Limits, Parent, Pause};
use crate::values::{Listen, MAX_ENVS, assignment, whole, workers_if_any};

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
cleanly; a second one stops within three seconds, without a checkpoint, and a third at once. \
`octopus resume RUN_DIR` goes on.";

/// Options of `octopus train`.
#[derive(Debug, Clone, Args)]
#[command(after_help = TRAIN_EXAMPLES)]
pub struct TrainArgs {
    /// The task [default: trajectory, unless --config says otherwise].
    #[arg(value_enum)]
    pub task: Option<Named<TaskName>>,
    /// The configuration to start from.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = Named(Preset::DEFAULT))]
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
    #[arg(long, value_name = "N|auto", allow_hyphen_values = true, value_parser = workers_if_any)]
    pub workers: Option<u64>,
    /// Fix each worker to a processor.
    #[arg(long)]
    pub pin: bool,
    /// Environments of the whole run, one episode each per iteration.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u64>(1, MAX_ENVS))]
    pub envs: Option<u64>,
    /// Seed of every random number.
    #[arg(long, value_name = "S", allow_hyphen_values = true, value_parser = whole::<u64>(0, i64::MAX as u64))]
    pub seed: Option<u64>,
    /// When to stop.
    #[command(flatten)]
    pub limits: Limits,
    /// Where to stop on the way.
    #[command(flatten)]
    pub pause: Pause,
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
    /// Help from other machines.
    #[command(flatten)]
    pub hosts: HostArgs,
    /// Check what is asked for, print the whole configuration as TOML (or JSON), and train nothing.
    #[arg(long)]
    pub dry_run: bool,
    /// What happens around the training.
    #[command(flatten)]
    pub ending: Ending,
    /// Who started it.
    #[command(flatten)]
    pub parent: Parent,
}

/// Trains, evaluates and says where everything is.
pub fn run(args: &TrainArgs) -> anyhow::Result<()> {
    if args.dry_run { show(args) } else { conclude(&train(args)?, args.ending) }
}

/// What would be trained, if it can be.
struct Plan {
    config: Config,
    robot: Robot,
    programs: Programs,
    gateway: Option<GatewaySpec>,
}

/// Everything that is asked for, checked, but whether the address of the service is free; nothing is written.
fn plan(args: &TrainArgs) -> anyhow::Result<Plan> {
    let config = precision::resolve(configure(args)?);
    check_service(&args.http)?;
    bucket::check(&config)?;
    let robot = run::robots::load_robot_of(&config)?;
    match &args.run_dir {
        Some(path) => {
            check_new(path)?;
            outputs::check_outside("--run-dir", path)?;
        }
        None => outputs::check_outside("--run-dir", &Path::new(RUNS).join("new"))?,
    }
    let programs = Programs::find()?;
    let gateway = args.hosts.gateway()?;
    let place = args.run_dir.as_deref().unwrap_or(Path::new(RUNS));
    preflight::check_machine(
        &config,
        &robot,
        &RunDir::new(place),
        &programs.learner,
        gateway.as_ref(),
        &REMEDY,
    )?;
    Ok(Plan { config, robot, programs, gateway })
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
    args.parent.tie()?;
    let Plan { config, robot, programs, gateway } = plan(args)?;
    let (run_dir, service) = open(args, &config)?;

    create(&run_dir)?;
    let domain = Domain::fresh();
    let lock = RunLock::acquire(&run_dir.lock(), domain.as_str())?;
    check_still_new(&run_dir)?;
    let provenance = Provenance::gather();
    files::replace(&run_dir.robot(), robot.to_toml().as_bytes())?;
    files::replace(&run_dir.config(), config.to_toml().as_bytes())?;
    record(&run_dir, &provenance, &[])?;
    let (resume, dir) = (None, run_dir.clone());
    let pause_at = args.pause.pause_at;
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
    run_session(start, lock, args.ending.quiet)
        .map_err(|error| errors::name_what_goes_on(error, &dir))
}

/// Env-steps that a run has at most, as its configuration is checked.
const MOST_ENV_STEPS: u64 = 1_000_000_000_000_000;

/// What helps a new run that its disk does not carry.
pub(crate) const REMEDY: Remedy = Remedy {
    elsewhere: "choose another --run-dir",
    less: Some("--set run.checkpoints_kept=1"),
    flags: &["--workers", "--envs"],
};

/// The run directory and the service that belongs to it. A directory of our own choice is made here, so
/// that no other run chooses it, and is gone again if there is no service.
fn open(args: &TrainArgs, config: &Config) -> anyhow::Result<(RunDir, RunService)> {
    let chosen = args.run_dir.is_none();
    let run_dir = match &args.run_dir {
        Some(path) => RunDir::new(path),
        None => claim(Path::new(RUNS), &default_name(config))?,
    };
    match args.http.open(&run_dir) {
        Ok(service) => Ok((run_dir, service)),
        Err(error) => {
            if chosen {
                // The error above is the one to report; an empty directory is no harm.
                let _ = std::fs::remove_dir(run_dir.path());
            }
            Err(error)
        }
    }
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
    // The command line bounds each, so that it fits.
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
        let text = regular_files::read_text(path, regular_files::TEXT)
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
        let steps = config.steps_per_iteration();
        let most = MOST_ENV_STEPS / steps;
        if iterations > most {
            return Err(ConfigError::Invalid {
                key: "iterations",
                problem: format!("{iterations} are too many of {steps} env-steps each"),
                cure: format!("choose {most} or less"),
            });
        }
        config.run.env_steps = iterations * steps;
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

/// Refuses a token file that is none, also where no service would ask for the token, and an address that others reach
/// where nobody has chosen a token.
pub(super) fn check_service(args: &HttpArgs) -> Result<(), ExitError> {
    let file = args.token_file.as_deref();
    match args.listen {
        Listen::At(address) => check_address(address, Token::find(file)?.as_ref()),
        Listen::Off => file.map_or(Ok(()), |path| Token::from_file(path).map(drop)),
    }
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
    fn too_many_iterations_are_refused_as_such() {
        let with = |iterations: u64| parse(&format!("octopus train --iterations {iterations}"));
        let most = MOST_ENV_STEPS / with(1).expect("valid").steps_per_iteration();
        assert_eq!(with(most).expect("valid").planned_iterations(), most);
        for iterations in [most + 1, 9_000_000_000_000_000] {
            let error = with(iterations).expect_err("too many");
            assert_eq!(error.code, ExitCode::BadInput);
            let [named, cure] = [
                format!("key `iterations`: {iterations} are too many"),
                format!("choose {most} or less"),
            ];
            assert!(error.message.contains(&named) && error.message.contains(&cure), "{error}");
        }
        let most = format!("octopus train --env-steps {MOST_ENV_STEPS}");
        assert_eq!(parse(&most).expect("valid").run.env_steps, MOST_ENV_STEPS);
        parse(&most.replace("1000", "1001")).expect_err("more");
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
    fn errors_name_the_flag() {
        let error = parse("octopus train --set algorithm.gama=0.9").expect_err("unknown");
        assert_eq!(
            error.to_string(),
            "--set algorithm.gama=0.9: unknown key `algorithm.gama`; did you mean `algorithm.gamma`?"
        );
        let error = parse("octopus train --algorithm ippo --set network.critic_state=compact")
            .expect_err("a contradiction")
            .to_string();
        assert!(error.contains("network.critic_state"), "{error}");
        let error = parse("octopus train --device tpu").expect_err("no device").to_string();
        assert!(error.starts_with("--device tpu: ") && error.contains("cuda:0"), "{error}");
    }
}
