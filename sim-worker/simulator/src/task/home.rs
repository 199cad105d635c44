//! What a task takes from the robot: where everything is at home.

use crate::robot::JOINTS_PER_ARM;

/// What [`Task::new`](super::Task::new) takes from the robot, all at its home pose.
#[derive(Debug, Clone)]
pub struct Home {
    /// Base position, world (m).
    pub base_position: [f64; 3],
    /// Base attitude, Euler angles (rad).
    pub base_euler: [f64; 3],
    /// One entry an arm.
    pub arms: Vec<HomeArm>,
}

/// An arm at the robot's home pose.
#[derive(Debug, Clone)]
pub struct HomeArm {
    /// Joint angles (rad).
    pub q: [f64; JOINTS_PER_ARM],
    /// Limits of the joint velocity commands (rad/s).
    pub command_limit: [f64; JOINTS_PER_ARM],
    /// Hand position, world (m).
    pub position: [f64; 3],
    /// Hand attitude, Euler angles (rad).
    pub euler: [f64; 3],
    /// Axes of the mount in the world, `[axis][component]`; the third points out of the base.
    pub mount: [[f64; 3]; 3],
}
