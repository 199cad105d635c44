//! `octopus mjcf`: a robot as a MuJoCo model file.

use std::path::Path;

use simulator::robot::mjcf::{MjcfOptions, mjcf};
use store::files;
use store::outputs::Output;

use crate::cli::{MjcfArgs, Switch};

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
