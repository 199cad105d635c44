//! The learner program; see [`learner::learner`].

use std::process::ExitCode;

use clap::Parser;
use learner::learner::{Arguments, run};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    proto::logging::init();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error}");
            ExitCode::from(error.code as u8)
        }
    }
}
