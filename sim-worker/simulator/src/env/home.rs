//! The home pose that tasks are relative to.

use super::Physics;
use crate::robot::{JOINTS_PER_ARM, Robot};
use crate::state::State;
use crate::step::StepOptions;
use crate::task::{Home, HomeArm, Readings};

/// The robot's home pose, by forward kinematics in `f64`.
pub(crate) fn home(robot: &Robot) -> Home {
    let mut physics = Physics::<f64>::with_options(robot, StepOptions::default());
    let mut readings = Readings::new(robot.n_arms);
    physics.read(&State::home(robot), &mut readings);
    let max_rates = robot.max_rates();
    let arms = robot.arms.iter().enumerate().map(|(index, arm)| HomeArm {
        q: arm.home,
        command_limit: std::array::from_fn(|joint| max_rates[index * JOINTS_PER_ARM + joint]),
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
