//! What a robot is made of: links, arms, and the pairs of bodies whose contact a joint's angle tells.

use nalgebra::{Matrix3, Vector3};
pub use proto::agents::{Joints, MAX_ARMS, MAX_JOINTS_PER_ARM, MIN_JOINTS_PER_ARM};

use super::{BaseBox, RigidBody, Shape};

/// A moving link of all arms of one type, in its link frame (see the module).
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

/// What arms of one type share.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmType {
    /// Its moving links, from the base to the hand.
    pub links: Vec<Link>,
    /// The hand's origin in the last link's frame (m).
    pub tool_position: Vector3<f64>,
    /// The hand's rotation to the last link's frame.
    pub tool_rotation: Matrix3<f64>,
    /// Pairs that touch by joint angle.
    pub angle_contacts: Vec<AngleContact>,
}

impl ArmType {
    /// Length of a stretched arm from its mount to the hand, at most (m).
    pub fn reach(&self) -> f64 {
        // The last link's own shift is in the tool's place.
        let links = &self.links[..self.links.len() - 1];
        links.iter().map(|link| link.shift.norm()).sum::<f64>() + self.tool_position.norm()
    }

    /// Mass of the moving links (kg).
    pub fn mass(&self) -> f64 {
        self.links.iter().map(|link| link.body.mass).sum()
    }
}

/// Where an arm stands and how it is folded at home.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Name.
    pub name: String,
    /// Which of the robot's types it is of.
    pub arm_type: usize,
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
    pub home: Vec<f64>,
}

/// A body of one arm that a contact by angle may name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmBody {
    /// The box between base and arm.
    Mount,
    /// The fixed first link.
    Pedestal,
    /// Moving link, from 0.
    Link(usize),
}

/// A pair of one arm that touches exactly when a joint stands in an interval: a contact told by angle, which needs no geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct AngleContact {
    /// The two bodies.
    pub pair: [ArmBody; 2],
    /// The joint, from 0.
    pub joint: usize,
    /// Middle of the interval (rad).
    pub centre: f64,
    /// Half of the interval's length (rad).
    pub half: f64,
    /// The half is shorter by this times |sin 2q| (rad).
    pub narrowing: f64,
    /// The joint q of the narrowing, from 0.
    pub narrowing_joint: usize,
    /// Whether the ends of the interval push back.
    pub push: bool,
}
