//! A task on a robot, as goals, observations and rewards read it.

use proto::config::{CriticState, JointAngles, Observation, Posture, Reward, TaskName};

use super::frame::ArmFrame;
use super::{Aim, GoalRanges, Home};
use crate::robot::Joints;

/// A task on a robot: everything that is the same in every environment and step.
#[derive(Debug, Clone)]
pub struct Task {
    /// Which task.
    pub name: TaskName,
    /// Which joints are whose.
    pub joints: Joints,
    /// What each arm works for.
    pub aims: Vec<Aim>,
    /// What agents see.
    pub observation: Observation,
    /// How agents see joint angles.
    pub joint_angles: JointAngles,
    /// What is known of goal postures.
    pub posture: Posture,
    /// What critics see.
    pub critic_state: CriticState,
    /// Weights of the rewards.
    pub reward: Reward,
    /// Time of a control step (s).
    pub control_period: f64,
    /// Factor from a clipped action to a joint velocity command (rad/s).
    pub action_scale: f64,
    /// Where goals are drawn from, and home, which they are relative to.
    pub goals: GoalRanges,
    /// Limits of the actions, one a joint, arm-major (rad/s).
    pub action_limit: Vec<f64>,
    /// One an arm.
    pub(super) frames: Vec<ArmFrame>,
}

impl Task {
    /// Whether its agents know goal postures.
    pub fn knows_postures(&self) -> bool {
        self.posture.seen || self.posture.gain > 0.0
    }

    /// The task of `config` on a robot with this home pose.
    pub fn new(config: &proto::config::Config, home: Home) -> Self {
        let task = &config.task;
        Self {
            name: task.name,
            joints: Joints::new(&home.arms.iter().map(|arm| arm.q.len()).collect::<Vec<_>>()),
            aims: (0..home.arms.len()).map(|arm| task.name.aim(arm, home.arms.len())).collect(),
            observation: task.observation,
            joint_angles: task.joint_angles,
            posture: task.posture,
            control_period: config.env.control_period,
            critic_state: config.network.critic_state,
            action_scale: task.action_scale,
            action_limit: home
                .arms
                .iter()
                .flat_map(|arm| arm.command_limit.iter().copied())
                .collect(),
            frames: home.arms.iter().map(ArmFrame::new).collect(),
            reward: task.reward,
            goals: GoalRanges::new(task.goal_box, task.base_goal_range, task.target, home),
        }
    }

    /// Arms of the robot.
    pub fn n_arms(&self) -> usize {
        self.goals.home.arms.len()
    }

    /// Axes of the frame in which `arm` sees, in those of the base: `[axis][component]`.
    pub fn arm_axes(&self, arm: usize) -> [[f64; 3]; 3] {
        self.frames[arm].axes()
    }
}
