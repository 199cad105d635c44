//! What can be measured.

use proto::ExitError;

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
#[expect(clippy::print_stdout, reason = "the figures are the program's output")]
pub fn run(measurement: &Measurement) -> Result<(), ExitError> {
    let figures = match measurement {
        Measurement::Update(arguments) => update::measure(arguments)?,
        Measurement::Receive(arguments) => transport::receive(arguments)?,
        // Its standard output belongs to the receiver.
        Measurement::Send(arguments) => return transport::send(arguments),
    };
    println!("{figures}");
    Ok(())
}
