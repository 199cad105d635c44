//! The commands of `octopus`, one file each.

pub mod bench;
pub mod checkpoints;
pub mod clean;
pub mod doctor;
pub mod eval;
pub mod experiment;
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
pub mod verify;

use std::io::BufReader;
use std::path::Path;

use anyhow::Context as _;
use proto::channel::Domain;
use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use simulator::robot::{Robot, RobotError};

use crate::checkpoint::CheckpointError;
use crate::cli::{Command, JanitorArgs};
use crate::janitor;
use crate::lock::LockError;

/// Two things that were compared are not the same. No failure but the answer, which standard output
/// holds: the program ends with exit code 1 and says no more.
#[derive(Debug, thiserror::Error)]
#[error("not the same")]
pub struct NotTheSame;

/// Does what the command line says.
pub fn run(command: Command) -> anyhow::Result<()> {
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
    if run_dir.config().is_file() {
        return Ok(run_dir);
    }
    let message = format!(
        "{}: is no run directory: it has no config.toml; `octopus status` lists the runs",
        path.display()
    );
    Err(ExitError::new(ExitCode::RunDirectory, message))
}

/// A text file of a run directory.
fn read_text(path: &Path) -> Result<String, ExitError> {
    std::fs::read_to_string(path).map_err(|error| {
        let message = format!("{}: cannot be read: {error}", path.display());
        ExitError::new(ExitCode::RunDirectory, message)
    })
}

/// The resolved configuration of a run.
pub(crate) fn read_config(run_dir: &RunDir) -> anyhow::Result<Config> {
    let path = run_dir.config();
    Ok(Config::from_resolved_toml(&read_text(&path)?, &path.display().to_string())?)
}

/// The robot called `name`, or described by the file of that name.
fn load_robot(name: &str) -> anyhow::Result<Robot> {
    if let Some(robot) = Robot::builtin(name) {
        return Ok(robot);
    }
    let text = std::fs::read_to_string(name).map_err(|error| {
        let builtin = Robot::builtin_names().collect::<Vec<_>>().join(", ");
        let message = format!(
            "robot {name}: {error}; give a TOML file, or one of the built-in robots: {builtin}"
        );
        ExitError::new(ExitCode::BadInput, message)
    })?;
    Ok(Robot::from_toml(&text, Path::new(name))?)
}

fn janitor_run(args: &JanitorArgs) -> anyhow::Result<()> {
    let domain = Domain::parse(&args.domain)?;
    janitor::run(&domain, BufReader::new(std::io::stdin())).context("cleaning up failed")
}
