//! The files in which a run keeps its configuration and its robot, read back.

use std::path::Path;

use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use simulator::robot::Robot;

use crate::checkpoint::MANIFEST;
use crate::regular_files;

/// The run directory at `path`, if it is one.
pub fn run_directory(path: &Path) -> Result<RunDir, ExitError> {
    let run_dir = RunDir::new(path);
    let config = run_dir.config();
    if config.is_file() {
        return Ok(run_dir);
    }
    if let Err(error) = regular_files::check(&config) {
        let message = format!("{}: cannot be read: {error}", config.display());
        return Err(ExitError::new(ExitCode::RunDirectory, message));
    }
    let what = match path.try_exists() {
        Ok(false) => "does not exist",
        _ => "is no run directory: it has no config.toml",
    };
    let message = format!("{}: {what}; `octopus status` lists the runs", path.display());
    Err(ExitError::new(ExitCode::RunDirectory, message))
}

/// Refuses a checkpoint: it has a configuration and a robot as a run has, but no training goes on in it.
pub fn check_no_checkpoint(run_dir: &RunDir, command: &str) -> Result<(), ExitError> {
    let dir = run_dir.path();
    if !dir.join(MANIFEST).is_file() {
        return Ok(());
    }
    let message = format!(
        "{}: is a checkpoint, not a run directory; `octopus eval {}` measures it, and `{command}` wants the \
         directory of the run that it comes from",
        dir.display(),
        output::quoted(dir)
    );
    Err(ExitError::new(ExitCode::RunDirectory, message))
}

/// A text file of a run directory that does not grow: its configuration, its robot, who trained it.
pub fn read_text(path: &Path) -> Result<String, ExitError> {
    regular_files::read_text(path, regular_files::TEXT).map_err(|error| {
        let message = format!("{}: cannot be read: {error}", path.display());
        ExitError::new(ExitCode::RunDirectory, message)
    })
}

/// The resolved configuration of a run. One that is none is damage: the run itself wrote it.
pub fn read_config(run_dir: &RunDir) -> anyhow::Result<Config> {
    let path = run_dir.config();
    let text = read_text(&path)?;
    let config = Config::from_resolved_toml(&text, &path.display().to_string());
    Ok(config.map_err(|error| damaged(&error))?)
}

/// The robot of a run, and its text.
pub fn read_robot(run_dir: &RunDir) -> anyhow::Result<(Robot, String)> {
    let path = run_dir.robot();
    let text = read_text(&path)?;
    let robot = Robot::from_toml(&text, &path).map_err(|error| damaged(&error))?;
    Ok((robot, text))
}

/// A file that a run has written is not as it was.
fn damaged(error: &dyn std::fmt::Display) -> ExitError {
    let message = format!("{error}; put the file back from a copy: every checkpoint holds one");
    ExitError::new(ExitCode::RunDirectory, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_run_says_whether_it_is_there() {
        let dir = tempfile::tempdir().expect("tempdir");
        let said = |path: &Path| run_directory(path).expect_err("no run").message;
        assert!(said(dir.path()).contains("is no run directory: it has no config.toml; `octopus"));
        assert!(said(&dir.path().join("none")).contains("none: does not exist; `octopus status`"));
    }
}
