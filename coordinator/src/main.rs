//! The `octopus` program; see [`coordinator::cli`].

use std::process::ExitCode;

use clap::Parser as _;
use coordinator::{cli::Cli, commands, logs, output};

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
            output::note(&format!("error: {}", format!("{error:#}").trim_end()));
            ExitCode::from(commands::exit_code(&error) as u8)
        }
    }
}
