//! The two tasks: what is aimed at, what agents see, what they are paid.
//!
//! * [`goal`]: where hands and base shall go, and how goals are drawn;
//! * [`observation`]: the numbers an agent sees, in three layouts;
//! * `frame`: whence an arm sees it, in the layout `arm`;
//! * [`state`]: the numbers a critic sees;
//! * [`reward`]: what a step is worth.
//!
//! All of it is generic over [`Real`](crate::scalar::Real) and reads one [`Readings`], so the same
//! text serves the lanes of a rollout and the `f64` of a test worked by hand.
//!
//! Agents: agent 2i moves joints 1–3 of arm i and cares for its hand's position, agent 2i + 1 moves
//! joints 4–6 and cares for its orientation. In the reorientation task all share one reward.
//!
//! Attitudes are Euler angles (a, b, c) of R = Rx(a)·Ry(b)·Rz(c). Attitude errors are plain
//! differences, goal − actual, without wrapping: every goal is far from the singular b = ±π/2.

pub mod goal;
pub mod observation;
pub mod reward;
pub mod state;

mod frame;
mod readings;

pub use goal::{ArmGoals, GoalRanges, Goals};
pub use readings::{ATTITUDE_WIDTHS, Errors, HandReading, POSITION_WIDTHS, Readings};

use proto::config::{CriticState, GoalBox, JointAngles, Observation, Reward, TaskName};

use self::frame::ArmFrame;
use crate::robot::JOINTS_PER_ARM;

/// A task on a robot: everything that is the same in every environment and step.
#[derive(Debug, Clone)]
pub struct Task {
    /// Which task.
    pub name: TaskName,
    /// What agents see.
    pub observation: Observation,
    /// How agents see joint angles.
    pub joint_angles: JointAngles,
    /// What critics see.
    pub critic_state: CriticState,
    /// Weights of the rewards.
    pub reward: Reward,
    /// Factor from a clipped action to a joint velocity command (rad/s).
    pub action_scale: f64,
    /// Where goals are drawn from, and home, which they are relative to.
    pub goals: GoalRanges,
    /// Limits of the actions, one a joint, arm-major (rad/s).
    pub action_limit: Vec<f64>,
    /// One an arm.
    frames: Vec<ArmFrame>,
}

/// What [`Task::new`] takes from the robot, all at its home pose.
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

impl Task {
    /// The task of `config` on a robot with this home pose.
    pub fn new(config: &proto::config::Config, home: Home) -> Self {
        let task = &config.task;
        Self {
            name: task.name,
            observation: task.observation,
            joint_angles: task.joint_angles,
            critic_state: config.network.critic_state,
            action_scale: task.action_scale,
            action_limit: home.arms.iter().flat_map(|arm| arm.command_limit).collect(),
            frames: home.arms.iter().map(ArmFrame::new).collect(),
            reward: task.reward,
            goals: GoalRanges::new(task.goal_box, task.base_goal_range, home),
        }
    }

    /// Arms of the robot.
    pub fn n_arms(&self) -> usize {
        self.goals.home.arms.len()
    }
}

/// Ranges of the hand goals of `goal_box`: along the mount's x, inward, and lateral (m).
pub(crate) fn box_ranges(goal_box: GoalBox) -> [[f64; 2]; 3] {
    match goal_box {
        GoalBox::Paper => [[-0.10, 0.20], [0.15, 0.45], [-0.15, 0.15]],
        GoalBox::Release => [[-0.05, 0.20], [0.10, 0.35], [-0.10, 0.15]],
        GoalBox::Narrow => [[-0.05, 0.15], [0.15, 0.35], [-0.10, 0.10]],
    }
}

#[cfg(test)]
mod tests;
