//! The `octopus` program; see [`coordinator::cli`].

use std::process::ExitCode;

use clap::Parser as _;
use coordinator::cli::Cli;
use coordinator::{NotTheSame, limits, logs};
use run::errors;
use store::provenance;

fn main() -> ExitCode {
    if let Err(error) = limits::prepare() {
        output::note(&format!("error: {error}"));
        return ExitCode::from(error.code as u8);
    }
    provenance::built_from(env!("SPACEOCTOPUS_COMMIT"));
    let cli = Cli::parse();
    logs::init();
    match coordinator::run(cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The answer has been printed.
            if error.is::<NotTheSame>() {
                return ExitCode::from(errors::exit_code(&error) as u8);
            }
            let text = errors::told(&error);
            output::note(&format!("error: {text}"));
            if let Some(cure) = limits::cure(&text) {
                output::note(&cure);
                return ExitCode::from(proto::ExitCode::Environment as u8);
            }
            ExitCode::from(errors::exit_code(&error) as u8)
        }
    }
}
