//! Options of every measurement.

use std::path::PathBuf;

use proto::ExitError;
use proto::run_dir::RunDir;

use crate::learner::load;

/// Options of every measurement.
#[derive(Debug, Clone, clap::Args)]
pub struct Common {
    /// Directory with config.toml and robot.toml.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// How long to measure (s).
    #[arg(long, value_name = "SECONDS")]
    pub seconds: f64,
    /// Process that started this one.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
}

impl Common {
    /// Dies with the parent from now on; reads what is to be measured.
    pub(super) fn begin(
        &self,
    ) -> Result<(proto::config::Config, proto::layout::Dimensions), ExitError> {
        process::child::die_with_parent(self.parent)?;
        Ok(load(&RunDir::new(&self.run_dir))?)
    }
}
