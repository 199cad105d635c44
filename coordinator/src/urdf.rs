//! `octopus urdf`: a robot as robot viewers draw it.

use clap::Args;
use simulator::robot::urdf::urdf;

use crate::robot_files::RobotFileArgs;

const URDF_EXAMPLES: &str = "\
Examples:
  octopus urdf --robot paper --out paper.urdf
  octopus urdf --robot my-robot.toml --out my-robot.urdf

Frames have the names of a recording of `octopus record`, so a viewer that has both moves the \
robot. Masses and limits are the robot's; capsules are drawn as cylinders with balls at their ends. Joints have the zero of \
the robot file, which is not home: `octopus robot import --home` takes the angles that they have there.";

/// Options of `octopus urdf`.
#[derive(Debug, Clone, Args)]
#[command(after_help = URDF_EXAMPLES)]
pub struct UrdfArgs {
    /// Which robot, and where to.
    #[command(flatten)]
    pub file: RobotFileArgs,
}

/// What a model begins with.
const MARK: &[u8] = b"<?xml version=\"1.0\"?>\n<robot name=";

/// Writes the model.
pub fn run(args: &UrdfArgs) -> anyhow::Result<()> {
    args.file.write(MARK, urdf)
}
