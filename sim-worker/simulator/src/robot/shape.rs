//! What can touch: capsules and discs of the arms, boxes of the base.

use nalgebra::{Matrix3, Vector3};

use super::RigidBody;

/// A shape for collisions, in its body's frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// All points within `radius` of a segment.
    Capsule {
        /// One end of the segment (m).
        from: Vector3<f64>,
        /// The other end (m).
        to: Vector3<f64>,
        /// Radius (m).
        radius: f64,
    },
    /// A flat cylinder.
    Disc {
        /// Centre (m).
        centre: Vector3<f64>,
        /// Axis, of length one.
        axis: Vector3<f64>,
        /// Radius (m).
        radius: f64,
        /// Half the height (m).
        half_height: f64,
    },
}

impl Shape {
    pub(super) fn moved(&self, rotation: &Matrix3<f64>, position: &Vector3<f64>) -> Self {
        match self {
            Self::Capsule { from, to, radius } => Self::Capsule {
                from: rotation * from + position,
                to: rotation * to + position,
                radius: *radius,
            },
            Self::Disc { centre, axis, radius, half_height } => Self::Disc {
                centre: rotation * centre + position,
                axis: rotation * axis,
                radius: *radius,
                half_height: *half_height,
            },
        }
    }
}

/// A solid box fixed to the base.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseBox {
    /// Name.
    pub name: String,
    /// Half of the edges (m).
    pub half: Vector3<f64>,
    /// Centre in the base frame (m).
    pub centre: Vector3<f64>,
    /// Rotation to the base frame.
    pub rotation: Matrix3<f64>,
    /// Inertial in the base frame.
    pub body: RigidBody,
}
