//! The worker program; see [`sim_worker::worker`].

use std::process::ExitCode;

use clap::Parser;
use sim_worker::worker::{Arguments, run};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    process::logging::init();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!(worker = arguments.worker, "{error}");
            ExitCode::from(error.code as u8)
        }
    }
}
