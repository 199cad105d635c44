//! What a robot is made of: links, arms, and the pairs of bodies whose contact a joint's angle tells.

use nalgebra::{Matrix3, Vector3};
pub use proto::agents::JOINTS_PER_ARM;

use super::{BaseBox, RigidBody, Shape};

/// Most arms a robot may have.
pub const MAX_ARMS: usize = 8;

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

/// A body of one arm that a contact by angle may name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmBody {
    /// The box between base and arm.
    Mount,
    /// The fixed first link.
    Pedestal,
    /// Moving link, 0…5.
    Link(usize),
}

/// A pair of one arm that touches exactly when a joint stands in an interval: a contact told by angle, which needs no geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct AngleContact {
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
