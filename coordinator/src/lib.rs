//! The `octopus` command: one file a command, its options beside what it does. What commands do with runs, stores
//! and policies is in the crates below: `lab`, `run`, `service`, `store`.
//!
//! It links no libtorch and starts in milliseconds.

pub mod cli;
pub mod endpoint;
pub mod names;
pub mod training_options;
pub mod values;

pub mod bench;
pub mod certificates;
pub mod checkpoints;
pub mod clean;
pub mod doctor;
pub mod eval;
pub mod experiment;
pub mod export;
pub mod film;
pub mod janitor;
pub mod join;
pub mod mjcf;
pub mod plan;
pub mod plot;
pub mod record;
pub mod replay;
pub mod reproduce;
pub mod resume;
pub mod robot;
pub mod rollout;
pub mod scale;
pub mod serve;
pub mod simulate;
pub mod status;
pub mod sweep;
pub mod train;
pub mod urdf;
pub mod verify;
pub mod view;

mod blocks;
mod conclusion;
mod joint_commands;
pub mod limits;
pub mod logs;
mod not_the_same;
mod planned_run;
mod robot_files;
mod trajectories;

use anyhow::Context as _;
use run::signals;

use crate::cli::Command;
pub use crate::not_the_same::NotTheSame;

/// Does what the command line says.
pub fn run(command: Command) -> anyhow::Result<()> {
    // Others have something to end first, or nothing to be stopped in.
    let stoppable = match &command {
        Command::Eval(_)
        | Command::Experiment(_)
        | Command::Export(_)
        | Command::Film(_)
        | Command::Plan(_)
        | Command::Record(_)
        | Command::Replay(_)
        | Command::Simulate(_)
        | Command::Rollout(_) => true,
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
        Command::Export(args) => export::run(&args),
        Command::Reproduce(args) => reproduce::run(&args),
        Command::Plot(args) => plot::run(&args),
        Command::Film(args) => film::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Robot(args) => robot::run(&args),
        Command::Mjcf(args) => mjcf::run(&args),
        Command::Urdf(args) => urdf::run(&args),
        Command::Doctor(args) => doctor::run(args),
        Command::Bench(args) => bench::run(&args),
        Command::Join(args) => join::run(&args),
        Command::Certificates(args) => certificates::run(&args),
        Command::Sweep(args) => sweep::run(&args),
        Command::Status(args) => status::run(&args),
        Command::Scale(args) => scale::run(&args),
        Command::Rollout(args) => rollout::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Checkpoints(args) => checkpoints::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::View(args) => view::run(&args),
        Command::Clean(args) => clean::run(args),
        Command::Janitor(args) => janitor::run(&args),
    }
}
