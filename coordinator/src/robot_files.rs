//! A robot as a file for other programs: what `mjcf` and `urdf` share.

use std::path::{Path, PathBuf};

use clap::Args;
use simulator::robot::Robot;
use store::files;
use store::outputs::Output;

/// Which robot, and where its file goes.
#[derive(Debug, Clone, Args)]
pub struct RobotFileArgs {
    /// `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE")]
    pub robot: String,
    /// The model file [default: standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write over files of another kind, too, and into a run's directory; what is read stays. A file of
    /// this command's own kind is replaced without it.
    #[arg(long)]
    pub force: bool,
}

impl RobotFileArgs {
    /// Writes what `model` makes of the robot; `mark` is what such files begin with.
    pub(crate) fn write(
        &self,
        mark: &[u8],
        model: impl FnOnce(&Robot) -> String,
    ) -> anyhow::Result<()> {
        let robot = run::robots::load_robot(&self.robot)?;
        if let Some(path) = &self.out {
            Output { flag: "--out", path, mark, force: self.force }
                .check_or_stdout(&[("--robot", Path::new(&self.robot))])?;
        }
        let model = model(&robot);
        match self.out.as_deref() {
            None => output::write(model.as_bytes()),
            Some(path) if path == Path::new("-") => output::write(model.as_bytes()),
            Some(path) => Ok(files::replace_output(path, model.as_bytes())?),
        }
    }
}
