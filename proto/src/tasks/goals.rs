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

use serde::{Deserialize, Serialize};

use super::target::Target;
use crate::rng::{Address, Purpose};

/// What goals and observations take from the robot, all at its home pose.
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
    pub q: Vec<f64>,
    /// Limits of the joint velocity commands (rad/s).
    pub command_limit: Vec<f64>,
    /// Hand position, world (m).
    pub position: [f64; 3],
    /// Hand attitude, Euler angles (rad).
    pub euler: [f64; 3],
    /// Axes of the mount in the world, `[axis][component]`; the third points out of the base.
    pub mount: [[f64; 3]; 3],
}

/// The box that trajectory goals are drawn from, as offsets to the hand's home position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GoalBox {
    /// A cube of 0.3 m, as the paper says.
    Paper,
    /// The released code: 0.25 m.
    Release,
    /// The authors' working repository: 0.20 m.
    Narrow,
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
    /// The body that hands take hold of.
    pub target: Target,
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

/// The goals that an episode begins with.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EpisodeGoals {
    /// Of each hand: position in the world (m), Euler angles (rad); none where it has no goal.
    pub hands: Vec<Option<[f64; 6]>>,
    /// Attitude of the base, Euler angles (rad).
    pub base: Option<[f64; 3]>,
    /// What carries the hands' goals, if they move.
    pub body: Option<FreeBody>,
}

/// A rigid body that no force acts on, at the start of an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeBody {
    /// Centre of mass, world (m).
    pub position: [f64; 3],
    /// Attitude, as the rotation vector from the world's axes (rad).
    pub turned: [f64; 3],
    /// Velocity of the centre of mass, world (m/s).
    pub linear: [f64; 3],
    /// Angular velocity, its own axes (rad/s).
    pub angular: [f64; 3],
    /// Principal moments of inertia; only their ratios count.
    pub inertia: [f64; 3],
}

impl GoalAddress {
    /// Four numbers in [0, 1), the group `index` of those that belong to this address.
    pub fn uniforms(self, index: u32) -> [f64; 4] {
        let Self { seed, purpose, iteration, env } = self;
        Address { seed, purpose, iteration, env, step: 0, index }.uniforms().map(f64::from)
    }
}

impl GoalRanges {
    /// The ranges for a robot with this home pose; base goals are within ± `base`, per axis (rad).
    pub fn new(goal_box: GoalBox, base: f64, target: Target, home: Home) -> Self {
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
        Self { home, arms, base, target }
    }

    /// Target pose of the hand of `arm`, somewhere around home: position (m) and Euler angles (rad), world.
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
        self.attitude_of(address, 0)
    }

    /// Likewise, from the group `index` of the address's numbers.
    pub fn attitude_of(&self, address: GoalAddress, index: u32) -> [f64; 3] {
        let u = address.uniforms(index);
        std::array::from_fn(|i| self.base * (2.0 * u[i] - 1.0))
    }
}

impl FreeBody {
    /// Where a hand is that the body carries: at `point`, in the body's axes from its centre of mass (m), with the attitude (Euler angles, rad) that it
    /// has in those axes. Position (m) and Euler angles (rad), world.
    pub fn carried(&self, point: [f64; 3], euler: [f64; 3]) -> [f64; 6] {
        let r = rotation_of(self.turned);
        let moved = times(&r, point);
        let [x, y, z] = [0, 1, 2].map(|i| self.position[i] + moved[i]);
        let hand = euler_to_rotation(euler);
        let columns = [0, 1, 2].map(|j| times(&r, [hand[0][j], hand[1][j], hand[2][j]]));
        let world = [0, 1, 2].map(|i| [columns[0][i], columns[1][i], columns[2][i]]);
        let [a, b, c] = rotation_to_euler(&world);
        [x, y, z, a, b, c]
    }
}

/// Rows of a rotation matrix.
type Rotation = [[f64; 3]; 3];

fn times(r: &Rotation, v: [f64; 3]) -> [f64; 3] {
    r.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// The rotation about a vector by its length (rad) [Rodrigues 1840].
fn rotation_of([x, y, z]: [f64; 3]) -> Rotation {
    let angle = libm::sqrt(x * x + y * y + z * z);
    if angle < 1e-12 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    let [x, y, z] = [x, y, z].map(|component| component / angle);
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    let d = 1.0 - c;
    [
        [c + d * x * x, d * x * y - s * z, d * x * z + s * y],
        [d * y * x + s * z, c + d * y * y, d * y * z - s * x],
        [d * z * x - s * y, d * z * y + s * x, c + d * z * z],
    ]
}

/// Rx(a)·Ry(b)·Rz(c).
fn euler_to_rotation([a, b, c]: [f64; 3]) -> Rotation {
    let [(sa, ca), (sb, cb), (sc, cc)] = [a, b, c].map(|x| (libm::sin(x), libm::cos(x)));
    [
        [cb * cc, -cb * sc, sb],
        [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
        [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
    ]
}

fn rotation_to_euler(r: &Rotation) -> [f64; 3] {
    let cos_b = libm::sqrt(r[2][2] * r[2][2] + r[1][2] * r[1][2]);
    [libm::atan2(-r[1][2], r[2][2]), libm::atan2(r[0][2], cos_b), libm::atan2(-r[0][1], r[0][0])]
}

/// Ranges of the hand goals of `goal_box`: along the mount's x, inward, and lateral (m).
fn box_ranges(goal_box: GoalBox) -> [[f64; 2]; 3] {
    match goal_box {
        GoalBox::Paper => [[-0.10, 0.20], [0.15, 0.45], [-0.15, 0.15]],
        GoalBox::Release => [[-0.05, 0.20], [0.10, 0.35], [-0.10, 0.15]],
        GoalBox::Narrow => [[-0.05, 0.15], [0.15, 0.35], [-0.10, 0.10]],
    }
}
