//! The robot: described in a file ([`description`]), checked and completed ([`Robot`]), laid out for the dynamics ([`Model`]).
//!
//! Frames. Standard Denavit–Hartenberg puts frame i at the far end of link i, behind joint i. The dynamics work in **link frames** at the near
//! end: link frame i is frame i−1 turned by the joint angle about its z axis, so every joint turns about its own link frame's z axis, and the step to
//! the next link frame is the constant shift (a, 0, d) and twist α. [`Link`] holds inertials and shapes moved there.

pub mod description;
mod error;
pub mod mjcf;
mod model;
mod resolve;
mod rigid_body;
mod shape;
mod wording;

use std::path::Path;

use nalgebra::{Matrix3, Vector3};

pub use description::RobotDescription;
pub use error::RobotError;
pub use mjcf::MjcfOptions;
pub use model::Model;
pub(crate) use model::{ArmModel, LinkModel, RigidInertia, Sparsity, StopModel, Twist};
pub use rigid_body::RigidBody;
pub(crate) use rigid_body::is_rotation;
pub use shape::{BaseBox, Shape};

/// Moving links of an arm.
pub const JOINTS_PER_ARM: usize = 6;

/// Most arms a robot may have.
pub const MAX_ARMS: usize = 8;

const BUILTIN: [(&str, &str); 2] = [
    ("paper", include_str!("../../robots/paper.toml")),
    ("release", include_str!("../../robots/release.toml")),
];

/// A moving link of every arm, in its link frame (see the module).
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Name.
    pub name: String,
    /// The next link frame's origin: (a, 0, d) (m).
    pub shift: Vector3<f64>,
    /// Rotation about x by the twist; right angles are exact.
    pub twist: Matrix3<f64>,
    /// Inertial in the link frame.
    pub body: RigidBody,
    /// Inertia of the drive (kg m²).
    pub armature: f64,
    /// Servo gain (N m s/rad).
    pub gain: f64,
    /// Largest commanded rate (rad/s).
    pub max_rate: f64,
    /// Largest torque (N m).
    pub max_torque: f64,
    /// Shapes in the link frame.
    pub shapes: Vec<Shape>,
}

/// Where an arm stands and how it is folded at home.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Name.
    pub name: String,
    /// Origin of frame 0 in the base frame (m).
    pub position: Vector3<f64>,
    /// Rotation of frame 0 to the base frame.
    pub rotation: Matrix3<f64>,
    /// The mount's box.
    pub mount: BaseBox,
    /// The pedestal's inertial in the base frame.
    pub pedestal: RigidBody,
    /// The pedestal's shapes in the base frame.
    pub pedestal_shapes: Vec<Shape>,
    /// Joint angles at home (rad).
    pub home: [f64; JOINTS_PER_ARM],
}

/// A body of one arm that a stop may name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmBody {
    /// The box between base and arm.
    Mount,
    /// The fixed first link.
    Pedestal,
    /// Moving link, 0…5.
    Link(usize),
}

/// A pair of one arm that touches exactly when a joint stands in an interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// The two bodies.
    pub pair: [ArmBody; 2],
    /// The joint, 0…5.
    pub joint: usize,
    /// Middle of the interval (rad).
    pub centre: f64,
    /// Half of the interval's length (rad).
    pub half: f64,
    /// The half is shorter by this times |sin 2q| (rad).
    pub narrowing: f64,
    /// The joint q of the narrowing, 0…5.
    pub narrowing_joint: usize,
    /// Whether the ends of the interval push back.
    pub push: bool,
}

/// A validated robot: a free-floating base with identical arms. Immutable.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Name.
    pub name: String,
    /// Number of arms, 1…[`MAX_ARMS`].
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
    pub stops: Vec<Stop>,
    /// Origin of the base frame in the world at home (m).
    pub home_position: [f64; 3],
    description: RobotDescription,
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

#[cfg(test)]
mod tests;
