//! The `octopus` program; see [`coordinator::cli`].

use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser as _;
use coordinator::{cli::Cli, commands, logs};

fn main() -> ExitCode {
    let cli = Cli::parse();
    logs::init();
    match commands::run(cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The answer has been printed.
            if error.is::<commands::NotTheSame>() {
                return ExitCode::from(commands::exit_code(&error) as u8);
            }
            // Nobody may be left to read it: a terminal that is closed ends a run, too.
            let _ = writeln!(std::io::stderr(), "error: {}", format!("{error:#}").trim_end());
            ExitCode::from(commands::exit_code(&error) as u8)
        }
    }
}
