//! The robot put together from its parts.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};

use super::wording;
use super::{
    AngleContact, Arm, BaseBox, JOINTS_PER_ARM, Link, RigidBody, RobotDescription, RobotError,
};

const BUILTIN: [(&str, &str); 2] = [
    ("paper", include_str!("../../robots/paper.toml")),
    ("release", include_str!("../../robots/release.toml")),
];

/// A validated robot: a free-floating base with identical arms. Immutable.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Name.
    pub name: String,
    /// Number of arms, 1…[`MAX_ARMS`](super::MAX_ARMS).
    pub n_arms: usize,
    /// Base with mounts and pedestals welded on, in the base frame.
    pub base: RigidBody,
    /// Boxes of the base, without the mounts.
    pub boxes: Vec<BaseBox>,
    /// The links of every arm.
    pub links: Vec<Link>,
    /// The hand's origin in the last link's frame (m).
    pub tool_position: Vector3<f64>,
    /// The hand's rotation to the last link's frame.
    pub tool_rotation: Matrix3<f64>,
    /// The arms.
    pub arms: Vec<Arm>,
    /// Pairs that touch by joint angle, in every arm.
    pub angle_contacts: Vec<AngleContact>,
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
        self.n_arms * JOINTS_PER_ARM
    }

    /// Joint angles at home (rad), arm-major.
    pub fn home_q(&self) -> Vec<f64> {
        self.arms.iter().flat_map(|a| a.home).collect()
    }

    /// Largest commanded rate of each joint (rad/s), arm-major.
    pub fn max_rates(&self) -> Vec<f64> {
        (0..self.n_joints()).map(|j| self.links[j % JOINTS_PER_ARM].max_rate).collect()
    }

    /// Torque of a joint's drive (N m) for a commanded rate at the rate `qd` (rad/s): clamp(k (clamp(c, ±c_max) − q̇), ±τ_max).
    pub fn torque(&self, joint: usize, command: f64, qd: f64) -> f64 {
        let link = &self.links[joint % JOINTS_PER_ARM];
        let rate = command.clamp(-link.max_rate, link.max_rate);
        (link.gain * (rate - qd)).clamp(-link.max_torque, link.max_torque)
    }

    /// Length of a stretched arm from its mount to the hand, at most (m).
    pub fn reach(&self) -> f64 {
        // The last link's own shift is in the tool's place.
        let links = &self.links[..JOINTS_PER_ARM - 1];
        links.iter().map(|link| link.shift.norm()).sum::<f64>() + self.tool_position.norm()
    }

    /// Mass of everything (kg).
    pub fn total_mass(&self) -> f64 {
        self.base.mass + self.n_arms as f64 * self.links.iter().map(|l| l.body.mass).sum::<f64>()
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
        for link in &mut description.links {
            link.mass *= factor;
            link.inertia = link.inertia.map(|element| factor * element);
        }
        Self::from_description(description, Path::new(&self.name))
    }
}
