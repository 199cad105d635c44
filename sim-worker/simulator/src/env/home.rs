//! The home pose that tasks are relative to.

use super::Physics;
use crate::robot::Robot;
use crate::state::State;
use crate::step::StepOptions;
use crate::task::{Home, HomeArm, Readings};

/// The robot's home pose, by forward kinematics in `f64`.
pub(crate) fn home(robot: &Robot) -> Home {
    let mut physics = Physics::<f64>::with_options(robot, StepOptions::default());
    let mut readings = Readings::new(&robot.joints);
    physics.read(&State::home(robot), &mut readings);
    let max_rates = robot.max_rates();
    let arms = robot.arms.iter().enumerate().map(|(index, arm)| HomeArm {
        q: arm.home.clone(),
        command_limit: max_rates[robot.joints.of_arm(index)].to_vec(),
        position: readings.hands[index].position,
        euler: readings.hands[index].euler,
        // At home the base's axes are the world's.
        mount: std::array::from_fn(|axis| arm.mount.rotation.column(axis).into_owned().into()),
    });
    Home {
        base_position: readings.base_position,
        base_euler: readings.base_euler,
        arms: arms.collect(),
    }
}
