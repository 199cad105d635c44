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
    check_is_toml(&text, path)?;
    Ok(Robot::from_toml(&text, path)?)
}

/// Refuses what is another file than that of a robot, where that can be told, and says what to do with it.
fn check_is_toml(text: &str, path: &Path) -> Result<(), ExitError> {
    let text = text.trim_start();
    let what = if text.is_empty() {
        "is empty; give a robot file (TOML), as `octopus robot import` makes of a URDF".to_owned()
    } else if text.starts_with('<') && text.contains("<robot") {
        let urdf = output::quoted(path);
        format!(
            "is a URDF; `octopus robot import {urdf} --out ROBOT.toml` makes a robot file of it"
        )
    } else if text.starts_with('<') {
        "is XML; give a robot file (TOML), as `octopus robot import` makes of a URDF".to_owned()
    } else {
        return Ok(());
    };
    Err(ExitError::new(ExitCode::BadInput, format!("robot {}: {what}", path.display())))
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
    config.task.name.check_arms(name, robot.n_arms).map_err(|refused| {
        let message = format!("{refused}; take another robot (robot.description) or another task");
        ExitError::new(ExitCode::BadInput, message)
    })?;
    Ok(robot)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_robot_file_is_said_to_be_what_it_is() {
        let said = |text| check_is_toml(text, Path::new("a b.urdf")).map_err(|error| error.message);
        let urdf = said("<?xml version=\"1.0\"?>\n<robot name=\"x\"/>").expect_err("a URDF");
        assert!(urdf.contains("`octopus robot import 'a b.urdf' --out"), "{urdf}");
        assert!(said("\n<mujoco/>").is_err_and(|said| said.contains("is XML")));
        assert!(said(" \n").is_err_and(|said| said.contains("is empty")));
        assert_eq!(said("name = \"x\""), Ok(()));
    }
}
