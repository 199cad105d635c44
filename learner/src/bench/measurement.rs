//! What can be measured.

use std::io::Write as _;

use proto::{ExitCode, ExitError};

use super::{transport, update};

/// What to measure.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Measurement {
    /// The update alone, on synthetic blocks.
    Update(update::Arguments),
    /// How long a block takes from another process to a tensor.
    Receive(transport::ReceiveArguments),
    /// The other process; started by `receive`.
    Send(transport::SendArguments),
}

/// Measures and prints.
pub fn run(measurement: &Measurement) -> Result<(), ExitError> {
    let figures = match measurement {
        Measurement::Update(arguments) => update::measure(arguments)?,
        Measurement::Receive(arguments) => transport::receive(arguments)?,
        // Its standard output belongs to the receiver.
        Measurement::Send(arguments) => return transport::send(arguments),
    };
    writeln!(std::io::stdout(), "{figures}").map_err(|error| {
        let message = format!("standard output cannot be written: {error}");
        ExitError::new(ExitCode::Failure, message)
    })
}
