//! The robot put together from its parts.

use std::path::Path;

use super::wording;
use super::{Arm, ArmType, BaseBox, Joints, Link, RigidBody, RobotDescription, RobotError};

const BUILTIN: [(&str, &str); 2] = [
    ("paper", include_str!("../../robots/paper.toml")),
    ("release", include_str!("../../robots/release.toml")),
];

/// A validated robot: a free-floating base with arms of one or several types. Immutable.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Name.
    pub name: String,
    /// Number of arms, 1…[`MAX_ARMS`](super::MAX_ARMS).
    pub n_arms: usize,
    /// Which joints are whose.
    pub joints: Joints,
    /// Base with mounts and pedestals welded on, in the base frame.
    pub base: RigidBody,
    /// Boxes of the base, without the mounts.
    pub boxes: Vec<BaseBox>,
    /// The types of its arms.
    pub types: Vec<ArmType>,
    /// The arms.
    pub arms: Vec<Arm>,
    /// Origin of the base frame in the world at home (m).
    pub home_position: [f64; 3],
    pub(super) description: RobotDescription,
}

impl Robot {
    /// Names of the built-in robots.
    pub fn builtin_names() -> impl Iterator<Item = &'static str> {
        BUILTIN.iter().map(|(name, _)| *name)
    }

    /// The built-in robot of that name: `paper` or `release`.
    pub fn builtin(name: &str) -> Option<Self> {
        let (_, text) = BUILTIN.iter().find(|(n, _)| *n == name)?;
        Some(Self::from_toml(text, Path::new(name)).expect("built-in robots are tested"))
    }

    /// Reads a description; `path` is only for messages.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, RobotError> {
        let description: RobotDescription = toml::from_str(text).map_err(|error| {
            let reason = wording::in_words(&error, text);
            RobotError::Parse { path: path.display().to_string(), reason }
        })?;
        Self::from_description(description, path)
    }

    /// The description as a TOML text that [`Robot::from_toml`] reads back to the same robot.
    pub fn to_toml(&self) -> String {
        toml::to_string(&self.description).expect("a description is plain data")
    }

    /// The description this robot was made of.
    pub fn description(&self) -> &RobotDescription {
        &self.description
    }

    /// Number of joints, all arms.
    pub fn n_joints(&self) -> usize {
        self.joints.n_joints()
    }

    /// The type of an arm.
    pub fn type_of(&self, arm: usize) -> &ArmType {
        &self.types[self.arms[arm].arm_type]
    }

    /// The link behind a joint, joints counted over all arms.
    pub fn link(&self, joint: usize) -> &Link {
        &self.type_of(self.joints.arm_of(joint)).links[self.joints.within_arm(joint)]
    }

    /// Joint angles at home (rad), arm-major.
    pub fn home_q(&self) -> Vec<f64> {
        self.arms.iter().flat_map(|arm| arm.home.iter().copied()).collect()
    }

    /// Largest commanded rate of each joint (rad/s), arm-major.
    pub fn max_rates(&self) -> Vec<f64> {
        (0..self.n_joints()).map(|joint| self.link(joint).max_rate).collect()
    }

    /// Torque of a joint's drive (N m) for a commanded rate at the rate `qd` (rad/s): clamp(k (clamp(c, ±c_max) − q̇), ±τ_max).
    pub fn torque(&self, joint: usize, command: f64, qd: f64) -> f64 {
        let link = self.link(joint);
        let rate = command.clamp(-link.max_rate, link.max_rate);
        (link.gain * (rate - qd)).clamp(-link.max_torque, link.max_torque)
    }

    /// Length of the longest arm stretched, from its mount to the hand, at most (m).
    pub fn reach(&self) -> f64 {
        (0..self.n_arms).map(|arm| self.type_of(arm).reach()).fold(0.0, f64::max)
    }

    /// Mass of everything (kg).
    pub fn total_mass(&self) -> f64 {
        self.base.mass + self.mass_of_arms()
    }

    /// Mass of what moves against the base (kg).
    pub fn mass_of_arms(&self) -> f64 {
        let of_type = |index: usize| {
            let arms = self.arms.iter().filter(|arm| arm.arm_type == index).count();
            arms as f64 * self.types[index].mass()
        };
        (0..self.types.len()).map(of_type).sum()
    }

    /// The same robot with another mass of the base's first box; its inertia scales along.
    pub fn with_base_mass(&self, mass: f64) -> Result<Self, RobotError> {
        let mut description = self.description.clone();
        description.base[0].mass = mass;
        Self::from_description(description, Path::new(&self.name))
    }

    /// The same robot with moving links of `factor` times their mass and inertia; the drives' inertias stay.
    pub fn with_arm_mass(&self, factor: f64) -> Result<Self, RobotError> {
        let mut description = self.description.clone();
        for link in description.links_of_types_mut().flatten() {
            link.mass *= factor;
            link.inertia = link.inertia.map(|element| factor * element);
        }
        Self::from_description(description, Path::new(&self.name))
    }
}
