//! From arguments to a running worker.

use std::path::{Path, PathBuf};

use process::originals;
use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use simulator::robot::Robot;
use simulator::rollout::World;

use super::arguments::Arguments;
use super::process::Worker;
use super::worker_loop::serve;

/// Works until it is told to stop.
pub fn run(arguments: &Arguments) -> Result<(), ExitError> {
    process::child::die_with_parent(arguments.parent)?;
    if let Some(index) = arguments.pin {
        process::child::pin(index)?;
    }
    let world = load(&RunDir::new(&arguments.run_dir))?;
    let mut worker = Worker::connect(arguments, &world)?;
    tracing::info!(
        worker = arguments.worker,
        incarnation = arguments.incarnation,
        backend = ?simulator::scalar::Backend::detect(),
        "ready"
    );
    serve(&mut worker)
}

/// Reads configuration and robot of a run.
pub fn load(run_dir: &RunDir) -> Result<World, ExitError> {
    let named = |path: PathBuf, text: std::io::Result<String>| {
        let origin = path.display().to_string();
        text.map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("{origin}: cannot be read: {error}"))
        })
        .map(|text| (text, origin))
    };
    let bad = |error: &dyn std::fmt::Display| ExitError::new(ExitCode::BadInput, error.to_string());
    let (text, origin) = named(run_dir.config(), originals::config(run_dir))?;
    let config = Config::from_resolved_toml(&text, &origin).map_err(|error| bad(&error))?;
    let (text, origin) = named(run_dir.robot(), originals::robot(run_dir))?;
    let robot = Robot::from_toml(&text, Path::new(&origin)).map_err(|error| bad(&error))?;
    Ok(World::new(&config, &robot))
}
