//! `octopus robot`: a robot of your own, brought from URDF and looked at before it is trained.

mod check;
mod import;

use clap::{Args, Subcommand};

const EXAMPLES: &str = "\
Examples:
  octopus robot import satellite.urdf --out satellite.toml
  octopus robot check satellite.toml";

/// Options of `octopus robot`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct RobotArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: RobotCommand,
}

/// What there is to do with a robot.
#[derive(Debug, Clone, Subcommand)]
pub enum RobotCommand {
    /// Make a robot file of a URDF.
    Import(import::ImportArgs),
    /// Say what a robot is, whether it can be simulated, and how many goals it can reach.
    Check(check::CheckArgs),
}

/// Does what the command line says.
pub fn run(args: &RobotArgs) -> anyhow::Result<()> {
    match &args.command {
        RobotCommand::Import(args) => import::run(args),
        RobotCommand::Check(args) => check::run(args),
    }
}
