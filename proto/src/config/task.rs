//! Group `task`: what is to be learned, what is seen, and what is paid.

use serde::{Deserialize, Serialize};

use crate::tasks::{GoalBox, Target, TaskName};

/// Which numbers an agent sees; the layouts stand in `sim-worker`'s `task::observation`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Observation {
    /// The paper's text: 28 numbers (25 for reorientation).
    Paper,
    /// The released code: 31 numbers (25 for reorientation).
    Release,
    /// The whole arm, pose errors at three scales, the last action; vectors in the arm's frame, which moves
    /// with the base, so that all arms see alike wherever it is.
    Arm,
}

/// How agents see a joint angle. Joints have no stops: angles that differ by 2π are one pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JointAngles {
    /// The angle relative to home (rad), with all turns that the joint has made.
    #[default]
    Unwound,
    /// Its sine and cosine: the same in every turn.
    SinCos,
}

impl JointAngles {
    /// Numbers that say one angle.
    pub fn numbers(self) -> usize {
        match self {
            Self::Unwound => 1,
            Self::SinCos => 2,
        }
    }
}

/// Weights of one agent kind's reward,
/// r = −(`quadratic`·e² + `log`·log₁₀(e² + ε) + `smoothness`·‖u − u⁻‖² + `effort`·‖u‖² + `collision`·co),
/// with e = `scale` × the norm of the task error and u the clipped action before scaling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RewardWeights {
    /// Factor on the error norm before it enters the reward.
    pub scale: f64,
    /// Weight of the squared error.
    pub quadratic: f64,
    /// Weight of the logarithm of the squared error.
    pub log: f64,
    /// Weight of the squared change of the action.
    pub smoothness: f64,
    /// Weight of the squared action.
    pub effort: f64,
    /// Weight of the collision term.
    pub collision: f64,
}

/// The reward of a task.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// ε inside the logarithm.
    pub epsilon: f64,
    /// Whether the collision term counts touching pairs (`true`) or only says whether any touch.
    pub count_collisions: bool,
    /// Whether an agent answers for contacts of its own arm alone, instead of the whole robot's.
    #[serde(default)]
    pub own_collisions: bool,
    /// Share of the mean of its arm's two rewards in an agent's (arms that reach); the rest is its own reward.
    #[serde(default)]
    pub team_spirit: f64,
    /// Agents of shoulder joints, who care for the hand's position (arms that reach).
    pub position: RewardWeights,
    /// Agents of wrist joints, who care for the hand's orientation (arms that reach).
    pub orientation: RewardWeights,
    /// Agents of arms that turn the base. They have all terms but contacts in common.
    pub base: RewardWeights,
}

/// Table `task.start`: where training episodes begin. Evaluations and experiments begin at home.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Share of the episodes that begin away from home, at rest unless `turning` is above 0.
    pub share: f64,
    /// There, joint angles are off home by up to this (rad), small offsets being more frequent.
    pub joints: f64,
    /// There, the base is turned by up to this about each axis (rad), likewise.
    pub attitude: f64,
    /// There, share of the arms that stand anywhere: every joint angle uniform in ±π of home.
    #[serde(default)]
    pub anywhere: f64,
    /// There, the robot turns as one body by up to this about each axis (rad/s), small rates being more
    /// frequent, and its centre of mass rests: as after a push that was taken back.
    #[serde(default)]
    pub turning: f64,
}

/// Table `task.randomization`: training episodes of a robot whose drives and sensors err, and whose masses are others (domain randomization; Tobin et al.
/// 2017, Peng et al. 2018). What errs is drawn for each episode, and no agent is told. Rewards and critics know
/// the truth. Evaluations and experiments have a robot that does not err.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Randomization {
    /// Share of the episodes in which commands are late. As many have friction, a wrong gain, other masses, and sensors that err, each drawn by itself.
    pub share: f64,
    /// Commands are late by up to this share of a control period, long delays being more frequent.
    pub delay: f64,
    /// Dry friction in each joint is up to this (N m).
    pub friction: f64,
    /// Each joint is faster or slower than commanded by up to this share.
    pub gain: f64,
    /// Each link of a type of arm, and the base, is heavier or lighter than described by up to this share, and its inertia is larger or smaller by as much.
    #[serde(default)]
    pub mass: f64,
    /// Sensors of positions err with a standard deviation of up to this, each axis (m), anew in each step; bad sensors are more frequent.
    pub position: f64,
    /// Sensors of angles and attitudes, likewise (rad).
    pub angle: f64,
    /// Sensors of linear velocities, likewise (m/s).
    pub velocity: f64,
    /// Sensors of joint rates and angular velocities, likewise (rad/s).
    pub rate: f64,
}

/// Table `task.posture`: what agents know of the joint angles that bring the hand to its goal (`trajectory`, layout `arm`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Posture {
    /// Whether an agent sees how far its arm's joints are from its goal posture, and critics of layout `compact` those of all arms.
    pub seen: bool,
    /// Share of what is left to the goal posture that a command covers in a control step by itself; what an agent does is added to it (residual
    /// policy learning; Silver et al. 2018, Johannink et al. 2019).
    pub gain: f64,
    /// Weight of a newly read pose of the base in the exponential moving average that postures follow; with 1 they follow what is read.
    #[serde(default = "everything")]
    pub trust: f64,
    /// Where less than this is left to every joint (rad), what an agent does counts less, in proportion to what is left to the farthest one: at the goal posture
    /// nothing. With 0, or where `gain` is 0, all of it counts everywhere.
    #[serde(default)]
    pub fade: f64,
}

impl Posture {
    /// Where less than this is left to every joint (rad), what an agent does counts less, if it ever does.
    pub fn fades(&self) -> Option<f64> {
        (self.gain > 0.0 && self.fade > 0.0).then_some(self.fade)
    }
}

impl Default for Posture {
    fn default() -> Self {
        Self { seen: false, gain: 0.0, trust: everything(), fade: 0.0 }
    }
}

fn everything() -> f64 {
    1.0
}

/// Group `task`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Which task.
    pub name: TaskName,
    /// What the agents see.
    pub observation: Observation,
    /// How they see joint angles (layout `arm`), and critics (`compact`).
    #[serde(default)]
    pub joint_angles: JointAngles,
    /// Control steps of an episode; its end is a truncation, never a termination.
    pub episode_steps: usize,
    /// Factor from a clipped action to a joint velocity command in rad/s.
    pub action_scale: f64,
    /// Where hand goals are drawn from.
    pub goal_box: GoalBox,
    /// Base goals are Euler angles uniform in ± this, per axis (rad).
    pub base_goal_range: f64,
    /// Where training episodes begin; at home if nothing is said.
    #[serde(default)]
    pub start: Start,
    /// What errs in training episodes; nothing if nothing is said.
    #[serde(default)]
    pub randomization: Randomization,
    /// What is known of goal postures; nothing if nothing is said.
    #[serde(default)]
    pub posture: Posture,
    /// What hands take hold of, in task `capture`.
    #[serde(default)]
    pub target: Target,
    /// The reward.
    pub reward: Reward,
}
