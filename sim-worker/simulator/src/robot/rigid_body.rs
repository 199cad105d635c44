//! Mass, centre of mass and inertia, moved and welded.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Mass, centre of mass and inertia of a rigid body.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidBody {
    /// Mass (kg).
    pub mass: f64,
    /// Centre of mass in the body's frame (m).
    pub com: Vector3<f64>,
    /// Inertia about the centre of mass, axes of the body's frame (kg m²).
    pub inertia: Matrix3<f64>,
}

impl RigidBody {
    /// The body seen from a frame in which its own frame stands at `position`, turned by `rotation`.
    #[must_use]
    pub fn moved(&self, rotation: &Matrix3<f64>, position: &Vector3<f64>) -> Self {
        Self {
            mass: self.mass,
            com: rotation * self.com + position,
            inertia: rotation * self.inertia * rotation.transpose(),
        }
    }

    /// Two bodies welded together, both given in the same frame.
    #[must_use]
    pub fn welded(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        let com = (self.com * self.mass + other.com * other.mass) / mass;
        let about = |b: &Self| b.inertia + point_inertia(b.mass, b.com - com);
        Self { mass, com, inertia: about(self) + about(other) }
    }

    /// Inertia about the origin of the body's frame (kg m²).
    pub fn inertia_at_origin(&self) -> Matrix3<f64> {
        self.inertia + point_inertia(self.mass, self.com)
    }
}

/// Inertia about the origin of a point mass at `r`.
fn point_inertia(mass: f64, r: Vector3<f64>) -> Matrix3<f64> {
    mass * (Matrix3::identity() * r.norm_squared() - r * r.transpose())
}

/// Whether `m` is a rotation up to rounding; models are built of nothing else.
pub(crate) fn is_rotation(m: &Matrix3<f64>) -> bool {
    (m * m.transpose() - Matrix3::identity()).norm() < 1e-12
        && Rotation3::from_matrix_unchecked(*m).matrix().determinant() > 0.0
}
