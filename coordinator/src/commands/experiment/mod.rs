//! `octopus experiment`: the paper's experiments, one file each.

mod arm_failure;
mod base_mass;
mod disturbance;
mod lab;
mod noise;
mod precision;
mod reassembly;
mod report;

use crate::cli::experiment::{ExperimentArgs, ExperimentCommand};

/// Runs one and prints.
pub fn run(args: &ExperimentArgs) -> anyhow::Result<()> {
    match &args.command {
        ExperimentCommand::Precision(args) => precision::run(args),
        ExperimentCommand::Disturbance(args) => disturbance::run(args),
        ExperimentCommand::ArmFailure(args) => arm_failure::run(args),
        ExperimentCommand::BaseMass(args) => base_mass::run(args),
        ExperimentCommand::Reassembly(args) => reassembly::run(args),
        ExperimentCommand::Noise(args) => noise::run(args),
    }
}
