//! The `octopus` program; see [`coordinator::cli`].

use std::process::ExitCode;

use clap::Parser as _;
use coordinator::{causes, cli::Cli, commands, logs};

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
            eprintln!("error: {}", causes::told(&error));
            ExitCode::from(commands::exit_code(&error) as u8)
        }
    }
}
