//! `octopus urdf`: a robot as robot viewers draw it.

use std::path::{Path, PathBuf};

use clap::Args;
use store::files;
use store::outputs::Output;

const URDF_EXAMPLES: &str = "\
Examples:
  octopus urdf --robot paper --out paper.urdf
  octopus urdf --robot my-robot.toml --out my-robot.urdf

Frames have the names of a recording of `octopus record`, so a viewer that has both moves the \
robot. Masses and limits are the robot's; capsules are drawn as cylinders with balls at their ends.";

/// Options of `octopus urdf`.
#[derive(Debug, Clone, Args)]
#[command(after_help = URDF_EXAMPLES)]
pub struct UrdfArgs {
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: String,
    /// The model file [default: standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write over a file that is there already, and into a run's directory; what is read stays.
    #[arg(long)]
    pub force: bool,
}

/// What a model begins with.
const MARK: &[u8] = b"<?xml version=\"1.0\"?>\n<robot name=";

/// Writes the model.
pub fn run(args: &UrdfArgs) -> anyhow::Result<()> {
    let robot = run::robots::load_robot(&args.robot)?;
    if let Some(path) = &args.out {
        Output { flag: "--out", path, mark: MARK, force: args.force }
            .check(&[("--robot", Path::new(&args.robot))])?;
    }
    let model = export::urdf(&robot);
    match args.out.as_deref() {
        None => output::write(model.as_bytes()),
        Some(path) if path == Path::new("-") => output::write(model.as_bytes()),
        Some(path) => Ok(files::replace_output(path, model.as_bytes())?),
    }
}
