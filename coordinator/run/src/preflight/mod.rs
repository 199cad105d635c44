//! What a run needs of the machine, checked before anything is created.
//!
//! Every check ends in a [`Check`]: what was found, and if that is not enough, the flag or command
//! that cures it. A run stops at the first one that fails; `octopus doctor` shows all that do not
//! depend on the run.

mod check;
mod dev_shm;
mod hardware;
mod learner;
mod limits;
mod run_directory;
mod smaller;

use std::path::Path;

use proto::config::Config;
use proto::layout::Dimensions;
pub use proto::mib;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use simulator::robot::Robot;
use store::checkpoint::CheckpointStore;
use store::provenance;

pub use self::check::{Check, Verdict};
pub use self::dev_shm::{MAKE_ROOM, scale, shared_memory, shared_memory_is_full};
pub use self::hardware::{arithmetic, memory, processors};
pub use self::learner::{device, gpu, libtorch};
pub use self::limits::{descriptors, file_size, memory_maps};
pub(crate) use self::run_directory::checkpoint_size;
pub use self::run_directory::{Remedy, disk};
use crate::supervisor::GatewaySpec;

/// Refuses to start a run that this machine cannot carry; logs what could be better. What the command that asks has of
/// [`Remedy::flags`] is in `flags`.
fn check_run(
    config: &Config,
    dimensions: &Dimensions,
    learner: &Path,
    gateways: usize,
    flags: &[&str],
) -> Result<(), ExitError> {
    let workers = config.run.workers;
    let checks: [&dyn Fn() -> Check; 8] = [
        &|| shared_memory(config, dimensions, gateways, flags),
        &|| file_size(config, dimensions),
        &|| descriptors(workers, flags),
        &|| memory_maps(workers),
        &|| processors(workers, config.run.learner_threads, flags),
        &|| arithmetic(config, &provenance::vector_extensions()),
        &|| libtorch(learner),
        &|| device(learner, &config.run.device),
    ];
    for check in checks {
        let check = check();
        match check.verdict {
            Verdict::Good => {}
            Verdict::Warning => output::note(&format!("note: {}", check.sentence())),
            Verdict::Failure => {
                return Err(ExitError::new(ExitCode::Environment, check.sentence()));
            }
        }
    }
    Ok(())
}

/// Refuses what the machine cannot carry, and a run that nobody would work for; `gateway` is where other machines may
/// join it, `remedy` is what helps.
pub fn check_machine(
    config: &Config,
    robot: &Robot,
    run_dir: &RunDir,
    learner: &Path,
    gateway: Option<&GatewaySpec>,
    remedy: &Remedy,
) -> Result<(), ExitError> {
    if config.run.workers == 0 && gateway.is_none() {
        let message = "run.workers is 0: a run without workers of its own needs --listen-workers, so that other machines \
                       can join it; or give --workers 1 or more";
        return Err(ExitError::new(ExitCode::Usage, message));
    }
    let dimensions = Dimensions::new(config, robot.joints);
    check_run(config, &dimensions, learner, gateway.iter().len(), remedy.flags)?;
    let there = CheckpointStore::new(run_dir.checkpoints()).list().map_or(0, |there| there.len());
    let disk = disk(run_dir.path(), config, &dimensions, there, remedy);
    if disk.verdict == Verdict::Failure {
        return Err(ExitError::new(ExitCode::RunDirectory, disk.sentence()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset, TaskName};

    use super::*;

    pub(super) fn config(set: &str) -> Config {
        let layers = Layers::new(Preset::Tuned, Some(TaskName::Trajectory)).set(set);
        layers.and_then(|layers| layers.resolve()).expect("valid")
    }
}
