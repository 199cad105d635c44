//! What `octopus bench` measures in this program: hidden subcommands that print one JSON object.
//!
//! They run in the learner because it alone links libtorch, and with the environment in which the
//! coordinator starts a learner, so that what is measured is what trains.

mod common;
pub mod flops;
mod measurement;
mod product;
mod transport;
mod update;

pub use common::Common;
pub use measurement::{Measurement, run};
