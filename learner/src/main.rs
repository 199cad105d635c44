//! The learner program; see [`learner::learner`] and, for the hidden `bench`, [`learner::bench`].

use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser;
use learner::bench::{self, Measurement};
use learner::learner::{Arguments, run};
use learner::panics;

/// Trains the policies of a SpaceOctopus run; started by `octopus`, not by hand.
#[derive(Debug, Parser)]
#[command(name = "learner", version, subcommand_negates_reqs = true)]
#[command(args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    arguments: Option<Arguments>,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Measures parts of the learner; started by `octopus bench`.
    #[command(subcommand, hide = true)]
    Bench(Measurement),
    /// Prints why nothing can be computed on a device, or nothing; started by `octopus train`.
    #[command(hide = true)]
    Probe {
        /// As `run.device` names it.
        device: String,
    },
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    process::logging::init();
    panics::log();
    let result = match (cli.command, cli.arguments) {
        (Some(Command::Bench(measurement)), _) => bench::run(&measurement),
        (Some(Command::Probe { device }), _) => {
            if let Err(reason) = learner::learner::device(&device) {
                // Nobody is left to be told if this fails.
                let _ = writeln!(std::io::stdout(), "{reason}");
            }
            Ok(())
        }
        (None, Some(arguments)) => run(&arguments),
        (None, None) => unreachable!("--run-dir and --domain are required without a subcommand"),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error}");
            ExitCode::from(error.code as u8)
        }
    }
}
