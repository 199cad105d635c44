//! Robots as commands name them.

use std::path::Path;

use proto::config::Config;
use proto::{ExitCode, ExitError};
use simulator::env::step_options;
use simulator::robot::Robot;
use simulator::step::StepOptions;
use store::regular_files;

use crate::shakedown::shakedown;

/// The robot called `name`, or described by the file of that name.
pub fn load_robot(name: &str) -> anyhow::Result<Robot> {
    if let Some(robot) = Robot::builtin(name) {
        return Ok(robot);
    }
    let path = Path::new(name);
    let text = regular_files::read_text(path, regular_files::TEXT).map_err(|error| {
        let builtin = Robot::builtin_names().collect::<Vec<_>>().join(", ");
        let message = format!(
            "robot {name}: {error}; give a TOML file, or one of the built-in robots: {builtin}"
        );
        ExitError::new(ExitCode::BadInput, message)
    })?;
    Ok(Robot::from_toml(&text, path)?)
}

/// The same, refused if it is no robot that can be simulated so; every command that simulates takes this one.
pub fn load_fit_robot(name: &str, options: &StepOptions) -> anyhow::Result<Robot> {
    let robot = load_robot(name)?;
    // What is built in is fit: a test holds it to that.
    if Robot::builtin_names().all(|builtin| builtin != name) {
        shakedown(&robot, name, options)?;
    }
    Ok(robot)
}

/// The robot of a run, refused where its task asks for more arms than it has.
pub fn load_robot_of(config: &Config) -> anyhow::Result<Robot> {
    let name = &config.robot.description;
    let robot = load_fit_robot(name, &step_options(config))?;
    let task = config.task.name;
    let (fewest, there) = (task.definition().fewest_arms(), robot.n_arms);
    if there < fewest {
        let message = format!(
            "robot {name} has {there} arm{}, and task `{}` needs {fewest}; take another robot (robot.description) or another task",
            if there == 1 { "" } else { "s" },
            task.as_str()
        );
        return Err(ExitError::new(ExitCode::BadInput, message).into());
    }
    Ok(robot)
}
