//! `octopus mjcf`: a robot as a MuJoCo model file.

use std::path::{Path, PathBuf};

use clap::Args;
use simulator::robot::mjcf::{MjcfOptions, mjcf};
use store::files;
use store::outputs::Output;

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
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: String,
    /// The model file [default: standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write over a file that is there already, and into a run's directory; what is read stays.
    #[arg(long)]
    pub force: bool,
    /// Whether shapes of the model collide.
    #[arg(long, allow_negative_numbers = true, value_name = "on|off", value_enum, default_value_t = Switch::On)]
    pub contacts: Switch,
}

/// What a model begins with.
const MARK: &[u8] = b"<mujoco model=";

/// Writes the model.
pub fn run(args: &MjcfArgs) -> anyhow::Result<()> {
    let robot = run::robots::load_robot(&args.robot)?;
    if let Some(path) = &args.out {
        Output { flag: "--out", path, mark: MARK, force: args.force }
            .check(&[("--robot", Path::new(&args.robot))])?;
    }
    let model = mjcf(&robot, MjcfOptions { contacts: args.contacts == Switch::On });
    match args.out.as_deref() {
        None => output::write(model.as_bytes()),
        Some(path) if path == Path::new("-") => output::write(model.as_bytes()),
        Some(path) => Ok(files::replace_output(path, model.as_bytes())?),
    }
}
