//! `octopus simulate`: the robot under given joint commands, open loop.

use std::path::{Path, PathBuf};

use clap::Args;
use proto::{ExitCode, ExitError};
use simulator::simulate::{Precision, simulate_from};
use simulator::state::State;
use simulator::step::{Integrator, StepOptions};
use store::files;
use store::outputs::Output;

use crate::joint_commands;
use crate::names::Named;
use crate::trajectories::{MARK, last_state, write_table};
use crate::values::{Switch, seconds};

const SIMULATE_USAGE: &str = "\
octopus simulate [OPTIONS] --robot <NAME|FILE> --actions <IN.csv>
                        --out <OUT.csv>";

const SIMULATE_EXAMPLES: &str = "\
Examples:
  octopus simulate --robot paper --actions in.csv --out out.csv
  octopus simulate --robot release --actions in.csv --out - | head
  octopus simulate --robot release --actions in.csv --out out.csv \\
      --precision f64 --integrator euler --substep 0.001
  octopus simulate --robot paper --state out.csv --actions a.csv --out all.csv

IN.csv has no header and one row per control step: joint velocity commands in rad/s, arm after \
arm (24 numbers for four arms). OUT.csv has a header and one row per control step, after it: t, \
base position (m) and quaternion (w first), joint angles (rad), velocity of the base (m/s, world \
axes; rad/s, body axes), joint rates (rad/s), hand positions (m), touching pairs. The third \
example is the scheme of the robot's authors.";

/// Options of `octopus simulate`.
#[derive(Debug, Clone, Args)]
#[command(override_usage = SIMULATE_USAGE, after_help = SIMULATE_EXAMPLES)]
pub struct SimulateArgs {
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: String,
    /// The commands; `-` reads standard input.
    #[arg(long, value_name = "IN.csv")]
    pub actions: PathBuf,
    /// Begin where a trajectory ends, instead of at home.
    #[arg(long, value_name = "FILE.csv")]
    pub state: Option<PathBuf>,
    /// The trajectory; `-` writes standard output.
    #[arg(long, value_name = "OUT.csv")]
    pub out: PathBuf,
    /// Write over files of another kind, too, and into a run's directory; what is read stays. A file of
    /// this command's own kind is replaced without it.
    #[arg(long)]
    pub force: bool,
    /// Arithmetic.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = Named(Precision::F32))]
    pub precision: Named<Precision>,
    /// Integration scheme.
    #[arg(long, allow_negative_numbers = true, value_enum, default_value_t = Named(Integrator::Rk3))]
    pub integrator: Named<Integrator>,
    /// Duration of an integration step; divides the control period.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.016, allow_hyphen_values = true, value_parser = seconds)]
    pub substep: f64,
    /// Duration of a control step.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.4, allow_hyphen_values = true, value_parser = seconds)]
    pub control_period: f64,
    /// Whether touching bodies push each other.
    #[arg(long, allow_negative_numbers = true, value_name = "on|off", value_enum, default_value_t = Switch::On)]
    pub contacts: Switch,
}

/// Integrates.
pub fn run(args: &SimulateArgs) -> anyhow::Result<()> {
    // Judged as training would run it: how coarse the steps are is what may be tried here.
    let robot = run::robots::load_fit_robot(&args.robot, &StepOptions::default())?;
    check_steps(args)?;
    let output = Output { flag: "--out", path: &args.out, mark: MARK, force: args.force };
    let mut inputs: Vec<(&'static str, &Path)> =
        vec![("--actions", &args.actions), ("--robot", Path::new(&args.robot))];
    inputs.extend(args.state.as_deref().map(|path| ("--state", path)));
    output.check_or_stdout(&inputs)?;
    let start = match &args.state {
        Some(path) => last_state(path, &robot)?,
        None => State::home(&robot),
    };
    let actions = joint_commands::read(&args.actions, robot.n_joints())?;
    let precision = args.precision.0;
    let options = StepOptions {
        integrator: args.integrator.0,
        control_period: args.control_period,
        substep: args.substep,
        contacts: args.contacts == Switch::On,
    };
    let rows = simulate_from(&robot, &start, &actions, precision, &options);
    if let Some(index) = rows.iter().position(|row| !row.state.is_finite()) {
        let message = format!(
            "the simulation blew up in row {} (t = {} s): a number is not finite; a smaller \
             --substep may help",
            index + 1,
            rows[index].t
        );
        return Err(ExitError::new(ExitCode::Failure, message).into());
    }
    let table = write_table(&robot, &rows, precision)?;
    if args.out == Path::new("-") {
        return output::write(&table);
    }
    Ok(files::replace_output(&args.out, &table)?)
}

/// The sub-step must fit the control period a whole number of times.
fn check_steps(args: &SimulateArgs) -> Result<(), ExitError> {
    let bad = |message: String| Err(ExitError::new(ExitCode::Usage, message));
    let SimulateArgs { control_period, substep, .. } = *args;
    if !(1e-4..=10.0).contains(&control_period) {
        return bad(format!(
            "--control-period {control_period}: choose a time from 0.0001 to 10 s"
        ));
    }
    if !(1e-5..=control_period).contains(&substep) {
        return bad(format!(
            "--substep {substep}: choose a time from 0.00001 to {control_period} s"
        ));
    }
    let substeps = control_period / substep;
    if (substeps - substeps.round()).abs() > 1e-6 * substeps {
        return bad(format!(
            "--substep {substep}: does not divide the control period of {control_period} s; choose a \
             whole fraction of it"
        ));
    }
    Ok(())
}
