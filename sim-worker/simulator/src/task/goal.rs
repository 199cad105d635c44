//! Goals: target poses of the hands and target attitudes of the base.
//!
//! Hand goals are offsets from the hand's **home** pose, uniform and independent, fixed in the
//! world: they do not move with the base. Offsets of the position are drawn along three axes of the
//! arm's mount: its x, inward (against its outward normal z), and lateral (against its y). On the
//! paper's robot these are the released code's axes with its signs: arm 1 (face +y) inward −y,
//! lateral +z; arm 2 (−y) +y, −z; arm 3 (+z) −z, −y; arm 4 (−z) +z, +y.
//!
//! Offsets of the orientation are added to the home Euler angles. Their ranges follow the released
//! code: on faces whose normal is mostly along the base's z the first angle turns by 0.5 to 1 rad,
//! elsewhere by −0.2 to 0.3; the other two change their sign on faces with a negative normal. A
//! robot with other faces gets ranges by the same rule.

use proto::config::{GoalBox, TaskName};
use proto::rng::{Address, Purpose};

use super::Home;
use crate::scalar::Real;

/// Goals of the environments of one lane group.
#[derive(Debug, Clone)]
pub struct Goals<S> {
    /// Target of each hand: position in the world (m), Euler angles (rad).
    pub hands: Vec<[S; 6]>,
    /// Target attitude of the base, Euler angles (rad).
    pub base: [S; 3],
}

/// Where goals are drawn from.
#[derive(Debug, Clone)]
pub struct GoalRanges {
    /// The robot at home.
    pub home: Home,
    /// One entry an arm.
    pub arms: Vec<ArmGoals>,
    /// Base goals are uniform in ± this, per axis (rad).
    pub base: f64,
}

/// Offsets of one hand's goals from its home pose.
#[derive(Debug, Clone)]
pub struct ArmGoals {
    /// World directions of the three position offsets.
    pub axes: [[f64; 3]; 3],
    /// Range of the offset along each axis (m).
    pub position: [[f64; 2]; 3],
    /// Range of the offset of each Euler angle (rad).
    pub orientation: [[f64; 2]; 3],
}

/// Which goals: the run, the draw's purpose, the iteration and the environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GoalAddress {
    /// Seed of the run or of the evaluation.
    pub seed: u64,
    /// [`Purpose::Goal`] or [`Purpose::EvaluationGoal`].
    pub purpose: Purpose,
    /// Iteration of the run.
    pub iteration: u32,
    /// Global index of the environment, or the episode of an evaluation.
    pub env: u32,
}

impl GoalAddress {
    fn uniforms(self, index: u32) -> [f64; 4] {
        let Self { seed, purpose, iteration, env } = self;
        Address { seed, purpose, iteration, env, step: 0, index }.uniforms().map(f64::from)
    }
}

impl GoalRanges {
    /// The ranges for a robot with this home pose.
    pub fn new(goal_box: GoalBox, base: f64, home: Home) -> Self {
        let position = box_ranges(goal_box);
        let arms = home
            .arms
            .iter()
            .map(|arm| {
                let [x, y, z] = arm.mount;
                let negated = |axis: [f64; 3]| axis.map(|component| -component);
                let main = (0..3).max_by(|&i, &j| z[i].abs().total_cmp(&z[j].abs()));
                let main = main.expect("three components");
                let first = if main == 2 { [0.5, 1.0] } else { [-0.2, 0.3] };
                let signed = |[low, high]: [f64; 2]| {
                    if z[main] >= 0.0 { [low, high] } else { [-high, -low] }
                };
                ArmGoals {
                    axes: [x, negated(z), negated(y)],
                    position,
                    orientation: [first, signed([-0.15, 0.35]), signed([-0.30, 0.20])],
                }
            })
            .collect();
        Self { home, arms, base }
    }

    /// Goals that lie at home, for which errors are distances from home.
    pub fn at_home<S: Real>(&self) -> Goals<S> {
        let hand = |arm: &super::HomeArm| {
            let [[x, y, z], [a, b, c]] = [arm.position, arm.euler];
            [x, y, z, a, b, c].map(S::splat)
        };
        Goals {
            hands: self.home.arms.iter().map(hand).collect(),
            base: self.home.base_euler.map(S::splat),
        }
    }

    /// Draws the goals of one environment into `lane` of `goals`.
    ///
    /// The goals that `task` does not have stay at home.
    pub fn draw<S: Real>(
        &self,
        task: TaskName,
        address: GoalAddress,
        lane: usize,
        goals: &mut Goals<S>,
    ) {
        match task {
            TaskName::Trajectory => {
                for arm in 0..self.arms.len() {
                    let pose = self.hand(arm, address);
                    for (slot, value) in goals.hands[arm].iter_mut().zip(pose) {
                        slot.set_lane(lane, value);
                    }
                }
            }
            TaskName::Reorientation => {
                let attitude = self.attitude(address);
                for (slot, value) in goals.base.iter_mut().zip(attitude) {
                    slot.set_lane(lane, value);
                }
            }
        }
    }

    /// Target pose of the hand of `arm`: position (m) and Euler angles (rad), world.
    pub fn hand(&self, arm: usize, address: GoalAddress) -> [f64; 6] {
        let within = |[low, high]: [f64; 2], u: f64| low + u * (high - low);
        let home = &self.home.arms[arm];
        let ranges = &self.arms[arm];
        // Two groups of four words an arm: three of each are used.
        let [u, v] = [0, 1].map(|group| address.uniforms(2 * arm as u32 + group));
        let mut pose = [0.0; 6];
        pose[..3].copy_from_slice(&home.position);
        for (i, axis) in ranges.axes.iter().enumerate() {
            let offset = within(ranges.position[i], u[i]);
            for (slot, component) in pose[..3].iter_mut().zip(axis) {
                *slot += offset * component;
            }
        }
        for i in 0..3 {
            pose[3 + i] = home.euler[i] + within(ranges.orientation[i], v[i]);
        }
        pose
    }

    /// Target attitude of the base, Euler angles (rad).
    pub fn attitude(&self, address: GoalAddress) -> [f64; 3] {
        let u = address.uniforms(0);
        std::array::from_fn(|i| self.base * (2.0 * u[i] - 1.0))
    }
}

/// Ranges of the hand goals of `goal_box`: along the mount's x, inward, and lateral (m).
fn box_ranges(goal_box: GoalBox) -> [[f64; 2]; 3] {
    match goal_box {
        GoalBox::Paper => [[-0.10, 0.20], [0.15, 0.45], [-0.15, 0.15]],
        GoalBox::Release => [[-0.05, 0.20], [0.10, 0.35], [-0.10, 0.15]],
        GoalBox::Narrow => [[-0.05, 0.15], [0.15, 0.35], [-0.10, 0.10]],
    }
}
