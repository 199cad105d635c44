//! What `octopus bench` measures in this program: hidden subcommands that print one JSON object.
//!
//! They run in the learner because it alone links libtorch, and with the environment in which the
//! coordinator starts a learner, so that what is measured is what trains.

pub mod flops;
mod product;
mod transport;
mod update;

use std::path::PathBuf;

use proto::ExitError;
use proto::run_dir::RunDir;

use crate::learner::load;

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

/// Options of every measurement.
#[derive(Debug, Clone, clap::Args)]
pub struct Common {
    /// Directory with config.toml and robot.toml.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// How long to measure (s).
    #[arg(long, value_name = "SECONDS")]
    pub seconds: f64,
    /// Process that started this one.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
}

impl Common {
    /// Dies with the parent from now on; reads what is to be measured.
    fn begin(&self) -> Result<(proto::config::Config, proto::layout::Dimensions), ExitError> {
        process::child::die_with_parent(self.parent)?;
        Ok(load(&RunDir::new(&self.run_dir))?)
    }
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
