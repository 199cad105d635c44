//! Where the programs of a run are.

use std::path::PathBuf;

use proto::{ExitCode, ExitError};

/// Where the programs of a run are.
#[derive(Debug, Clone)]
pub struct Programs {
    /// `learner`; nothing where nobody learns.
    pub learner: PathBuf,
    /// `sim-worker`.
    pub sim_worker: PathBuf,
}

impl Programs {
    /// Looks beside this program, then along `PATH`.
    pub fn find() -> Result<Self, ExitError> {
        Ok(Self { learner: find("learner")?, sim_worker: find("sim-worker")? })
    }

    /// The same on a machine where nobody learns.
    pub fn without_learner() -> Result<Self, ExitError> {
        Ok(Self { learner: PathBuf::new(), sim_worker: find("sim-worker")? })
    }

    /// The program that carries a run to other machines, which not everybody has built.
    pub fn gateway() -> Result<PathBuf, ExitError> {
        find("gateway")
    }
}

fn find(name: &str) -> Result<PathBuf, ExitError> {
    let beside = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(name)));
    let path = std::env::var_os("PATH").unwrap_or_default();
    beside
        .into_iter()
        .chain(std::env::split_paths(&path).map(|dir| dir.join(name)))
        .find(|candidate| candidate.is_file())
        .ok_or_else(|| {
            ExitError::new(
                ExitCode::Environment,
                format!(
                    "program `{name}` is neither beside octopus nor on PATH; run `make {}`",
                    if name == "gateway" { name } else { "build" }
                ),
            )
        })
}
