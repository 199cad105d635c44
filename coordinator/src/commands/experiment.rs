//! `octopus experiment`: the paper's experiments.

use lab::experiments::common::Common;
use lab::experiments::lab::Lab;
use lab::experiments::{Experiment, arm_failure, base_mass, disturbance, noise, perform, precision, reassembly};

use crate::cli::experiment::{CommonArgs, ExperimentArgs, ExperimentCommand, Failing};

/// Runs one and prints.
pub fn run(args: &ExperimentArgs) -> anyhow::Result<()> {
    match args.command.clone() {
        ExperimentCommand::Precision(args) => {
            let (common, agents) = (study(&args.common), args.agents);
            print(&precision::Study { common, agents }, args.common.json)
        }
        ExperimentCommand::Disturbance(args) => {
            let (common, json) = (study(&args.common), args.common.json);
            let (arm, at, force, torque) = (args.arm, args.at, args.force, args.torque);
            print(&disturbance::Study { common, arm, at, force, torque }, json)
        }
        ExperimentCommand::ArmFailure(args) => {
            let arm = match args.arm {
                Failing::One(arm) => arm_failure::Failing::One(arm),
                Failing::Each => arm_failure::Failing::Each,
            };
            print(&arm_failure::Study { common: study(&args.common), arm }, args.common.json)
        }
        ExperimentCommand::BaseMass(args) => {
            let (common, json) = (study(&args.common), args.common.json);
            let (masses, thresholds) = (args.masses.0, args.thresholds.0);
            print(&base_mass::Study { common, masses, thresholds }, json)
        }
        ExperimentCommand::Reassembly(args) => {
            let (common, json) = (study(&args.common), args.common.json);
            print(&reassembly::Study { common, action_scale: args.action_scale }, json)
        }
        ExperimentCommand::Noise(args) => {
            let study = noise::Study {
                common: study(&args.common),
                sensors: args.sensors.0,
                torques: args.torques.0,
                delays: args.delays.0,
                arm_masses: args.arm_masses.0,
            };
            print(&study, args.common.json)
        }
    }
}

/// What all experiments are asked for with.
fn study(args: &CommonArgs) -> Common {
    Common {
        policies: args.policies.clone(),
        trajectory: args.trajectory.clone(),
        reorientation: args.reorientation.clone(),
        robot: args.robot.clone(),
        episodes: args.episodes,
        steps: args.steps,
        seed: args.seed,
    }
}

fn print<E: Experiment>(experiment: &E, json: bool) -> anyhow::Result<()> {
    let lab = Lab::new(experiment)?;
    let report = perform(experiment, &lab)?;
    lab.end();
    if json {
        return output::json(&report);
    }
    output::line(&experiment.printed(output::columns(), &report))
}
