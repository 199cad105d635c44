//! The gateway program; see [`gateway`].

use std::process::ExitCode;

use clap::Parser as _;
use gateway::arguments::{Arguments, Role};
use gateway::{host, hub};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    process::logging::init();
    let result = match &arguments.role {
        Role::Hub(arguments) => hub::run(arguments),
        Role::Host(arguments) => host::run(arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error}");
            ExitCode::from(error.code as u8)
        }
    }
}
