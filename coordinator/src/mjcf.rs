//! `octopus mjcf`: a robot as a MuJoCo model file.

use clap::Args;
use simulator::robot::mjcf::{MjcfOptions, mjcf};

use crate::robot_files::RobotFileArgs;
use crate::values::Switch;

const MJCF_EXAMPLES: &str = "\
Examples:
  octopus mjcf --robot release --out release.xml
  octopus mjcf --robot my-robot.toml --out my-robot.xml
  python -m mujoco.viewer --mjcf=my-robot.xml";

/// Options of `octopus mjcf`.
#[derive(Debug, Clone, Args)]
#[command(after_help = MJCF_EXAMPLES)]
pub struct MjcfArgs {
    /// Which robot, and where to.
    #[command(flatten)]
    pub file: RobotFileArgs,
    /// Whether shapes of the model collide.
    #[arg(long, allow_negative_numbers = true, value_name = "on|off", value_enum, default_value_t = Switch::On)]
    pub contacts: Switch,
}

/// What a model begins with.
const MARK: &[u8] = b"<mujoco model=";

/// Writes the model.
pub fn run(args: &MjcfArgs) -> anyhow::Result<()> {
    let options = MjcfOptions { contacts: args.contacts == Switch::On };
    args.file.write(MARK, |robot| mjcf(robot, options))
}
