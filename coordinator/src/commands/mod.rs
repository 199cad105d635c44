//! The commands of `octopus`, one file each.

pub mod bench;
pub mod checkpoints;
pub mod clean;
pub mod doctor;
pub mod eval;
pub mod experiment;
mod full;
pub mod mjcf;
pub mod plot;
pub mod reproduce;
pub mod resume;
pub mod rollout;
pub mod scale;
pub mod serve;
pub mod simulate;
pub mod statistics;
pub mod status;
pub mod train;
pub mod trained;
pub(crate) mod verdict;
pub mod verify;

use std::io::BufReader;
use std::path::Path;

use anyhow::Context as _;
use channels::Domain;
use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use simulator::robot::{Robot, RobotError};
use simulator::step::StepOptions;

use crate::cli::{Command, JanitorArgs};
use run::janitor;
use run::shakedown::shakedown;
use run::signals;
use store::checkpoint::CheckpointError;
use store::lock::LockError;
use store::regular;

/// Two things that were compared are not the same. No failure but the answer, which standard output
/// holds: the program ends with exit code 1 and says no more.
#[derive(Debug, thiserror::Error)]
#[error("not the same")]
pub struct NotTheSame;

/// Does what the command line says.
pub fn run(command: Command) -> anyhow::Result<()> {
    // Others have something to end first, or nothing to be stopped in.
    let stoppable = match &command {
        Command::Eval(_) | Command::Experiment(_) | Command::Simulate(_) | Command::Rollout(_) => {
            true
        }
        Command::Reproduce(args) => !args.train,
        _ => false,
    };
    if stoppable {
        signals::exit_when_asked("stopped".to_owned()).context("signals cannot be caught")?;
    }
    match command {
        Command::Train(args) => train::run(&args),
        Command::Resume(args) => resume::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Experiment(args) => experiment::run(&args),
        Command::Reproduce(args) => reproduce::run(&args),
        Command::Plot(args) => plot::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Mjcf(args) => mjcf::run(&args),
        Command::Doctor(args) => doctor::run(args),
        Command::Bench(args) => bench::run(&args),
        Command::Status(args) => status::run(&args),
        Command::Scale(args) => scale::run(&args),
        Command::Rollout(args) => rollout::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Checkpoints(args) => checkpoints::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Clean(args) => clean::run(args),
        Command::Janitor(args) => janitor_run(&args),
    }
}

/// The exit code that an error ends the program with: that of the innermost cause that has one.
pub fn exit_code(error: &anyhow::Error) -> ExitCode {
    let code = |cause: &(dyn std::error::Error + 'static)| {
        if let Some(error) = cause.downcast_ref::<ExitError>() {
            return Some(error.code);
        }
        if cause.is::<ConfigError>() || cause.is::<RobotError>() {
            return Some(ExitCode::BadInput);
        }
        (cause.is::<CheckpointError>() || cause.is::<LockError>()).then_some(ExitCode::RunDirectory)
    };
    error.chain().find_map(code).unwrap_or(ExitCode::Failure)
}

/// The run directory at `path`, if it is one.
pub(crate) fn run_directory(path: &Path) -> Result<RunDir, ExitError> {
    let run_dir = RunDir::new(path);
    let config = run_dir.config();
    if config.is_file() {
        return Ok(run_dir);
    }
    if let Err(error) = regular::check(&config) {
        let message = format!("{}: cannot be read: {error}", config.display());
        return Err(ExitError::new(ExitCode::RunDirectory, message));
    }
    let message = format!(
        "{}: is no run directory: it has no config.toml; `octopus status` lists the runs",
        path.display()
    );
    Err(ExitError::new(ExitCode::RunDirectory, message))
}

/// A text file of a run directory.
fn read_text(path: &Path) -> Result<String, ExitError> {
    regular::read_text(path, regular::TEXT).map_err(|error| {
        let message = format!("{}: cannot be read: {error}", path.display());
        ExitError::new(ExitCode::RunDirectory, message)
    })
}

/// The resolved configuration of a run. One that is none is damage: the run itself wrote it.
pub(crate) fn read_config(run_dir: &RunDir) -> anyhow::Result<Config> {
    let path = run_dir.config();
    let text = read_text(&path)?;
    let config = Config::from_resolved_toml(&text, &path.display().to_string());
    Ok(config.map_err(|error| damaged(&error))?)
}

/// The robot of a run, and its text.
pub(crate) fn read_robot(run_dir: &RunDir) -> anyhow::Result<(Robot, String)> {
    let path = run_dir.robot();
    let text = read_text(&path)?;
    let robot = Robot::from_toml(&text, &path).map_err(|error| damaged(&error))?;
    Ok((robot, text))
}

/// A file that a run has written is not as it was.
fn damaged(error: &dyn std::fmt::Display) -> ExitError {
    let message = format!("{error}; put the file back from a copy: every checkpoint holds one");
    ExitError::new(ExitCode::RunDirectory, message)
}

/// The robot called `name`, or described by the file of that name.
fn load_robot(name: &str) -> anyhow::Result<Robot> {
    if let Some(robot) = Robot::builtin(name) {
        return Ok(robot);
    }
    let path = Path::new(name);
    let text = regular::read_text(path, regular::TEXT).map_err(|error| {
        let builtin = Robot::builtin_names().collect::<Vec<_>>().join(", ");
        let message = format!(
            "robot {name}: {error}; give a TOML file, or one of the built-in robots: {builtin}"
        );
        ExitError::new(ExitCode::BadInput, message)
    })?;
    Ok(Robot::from_toml(&text, path)?)
}

/// The same, refused if it is no robot that can be simulated so; every command that simulates takes this one.
fn load_fit_robot(name: &str, options: &StepOptions) -> anyhow::Result<Robot> {
    let robot = load_robot(name)?;
    // What is built in is fit: a test holds it to that.
    if Robot::builtin_names().all(|builtin| builtin != name) {
        shakedown(&robot, name, options)?;
    }
    Ok(robot)
}

fn janitor_run(args: &JanitorArgs) -> anyhow::Result<()> {
    let domain = Domain::parse(&args.domain)?;
    janitor::run(&domain, BufReader::new(std::io::stdin())).context("cleaning up failed")
}
