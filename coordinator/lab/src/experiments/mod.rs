//! The paper's experiments, one file each.
//!
//! A `Study` is what is asked of an [`Experiment`]. [`perform`] makes a [`Report`](report::Report) of it, which is what `octopus experiment` prints
//! and what `octopus reproduce` writes and draws.

pub mod arm_failure;
pub mod base_mass;
pub mod command_line;
pub mod common;
pub mod disturbance;
mod experiment;
pub mod lab;
mod name;
pub mod noise;
pub mod precision;
pub mod reassembly;
pub mod report;

pub use self::experiment::{Experiment, ReportOf, perform};
pub use self::name::Name;
