//! Convex shapes as a core and a radius around it, and where they stand.

use nalgebra::{Matrix3, Vector3};

use crate::robot::Shape;
use crate::scalar::Real;
use crate::spatial::{Mat3, Vec3, add, mat_vec, mul_add, scale};

/// Core of a shape, in the frame of its body or, once placed, of the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Core<S> {
    /// A segment.
    Segment {
        /// One end (m).
        from: Vec3<S>,
        /// The other end (m).
        to: Vec3<S>,
    },
    /// A solid cylinder.
    Cylinder {
        /// Centre (m).
        centre: Vec3<S>,
        /// Axis, of length one.
        axis: Vec3<S>,
        /// Radius (m).
        radius: S,
        /// Half the height (m).
        half: S,
    },
}

/// All points within `radius` of a core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rounded<S> {
    /// The core.
    pub core: Core<S>,
    /// Radius around it (m).
    pub radius: S,
}

/// A box fixed to the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedBox<S> {
    /// Centre (m).
    pub centre: Vec3<S>,
    /// Box axes to base axes.
    pub rotation: Mat3<S>,
    /// Half of its edges (m).
    pub half: Vec3<S>,
}

impl<S: Real> Rounded<S> {
    /// A robot's shape.
    ///
    /// A flat cylinder becomes a smaller one with a radius around it, half of its smaller measure: closest points need cores that stay apart
    /// when shapes touch. Only its edges lose by that, 0.41 of the radius (3.6 mm for a UR5's last link).
    pub(crate) fn new(shape: &Shape) -> Self {
        match shape {
            Shape::Capsule { from, to, radius } => Self {
                core: Core::Segment {
                    from: (*from).map(S::splat).into(),
                    to: (*to).map(S::splat).into(),
                },
                radius: S::splat(*radius),
            },
            Shape::Disc { centre, axis, radius, half_height } => {
                let round = radius.min(*half_height) / 2.0;
                Self {
                    core: Core::Cylinder {
                        centre: (*centre).map(S::splat).into(),
                        axis: (*axis).map(S::splat).into(),
                        radius: S::splat(radius - round),
                        half: S::splat(half_height - round),
                    },
                    radius: S::splat(round),
                }
            }
        }
    }
}

impl<S: Real> Core<S> {
    /// The core in the base frame, given its body's pose.
    #[inline(always)]
    pub(crate) fn placed(&self, r: &Mat3<S>, o: Vec3<S>) -> Self {
        match *self {
            Self::Segment { from, to } => {
                Self::Segment { from: add(mat_vec(r, from), o), to: add(mat_vec(r, to), o) }
            }
            Self::Cylinder { centre, axis, radius, half } => Self::Cylinder {
                centre: add(mat_vec(r, centre), o),
                axis: mat_vec(r, axis),
                radius,
                half,
            },
        }
    }
}

/// A capsule around shapes: what is farther than `radius` from its segment is outside of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound<S> {
    /// One end of the segment (m).
    pub from: Vec3<S>,
    /// The other end (m).
    pub to: Vec3<S>,
    /// Radius (m).
    pub radius: S,
}

impl Bound<f64> {
    /// A capsule that holds the shapes of a body, along the longest distance within them.
    pub(crate) fn around(shapes: &[Shape]) -> Option<Self> {
        // A disc lies within a capsule of its radius along its axis.
        let balls: Vec<(Vector3<f64>, f64)> = shapes
            .iter()
            .flat_map(|shape| match shape {
                Shape::Capsule { from, to, radius } => [(*from, *radius), (*to, *radius)],
                Shape::Disc { centre, axis, radius, half_height } => [
                    (centre - axis * *half_height, *radius),
                    (centre + axis * *half_height, *radius),
                ],
            })
            .collect();
        let pairs = balls.iter().flat_map(|a| balls.iter().map(|b| b.0 - a.0));
        let longest = pairs.max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        let axis = longest.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        // In axes whose x is the capsule's: a box around the centres, and its middle line.
        let turn = turn_to_x(&axis);
        let centres: Vec<Vector3<f64>> = balls.iter().map(|(c, _)| turn * c).collect();
        let low = centres.iter().copied().reduce(|a, b| a.inf(&b))?;
        let high = centres.iter().copied().reduce(|a, b| a.sup(&b))?;
        let middle = (low + high) / 2.0;
        let end = |x: f64| (turn.transpose() * Vector3::new(x, middle.y, middle.z)).into();
        let radius = centres
            .iter()
            .zip(&balls)
            .map(|(c, (_, r))| (c - middle).yz().norm() + r)
            .fold(0.0, f64::max);
        Some(Self { from: end(low.x), to: end(high.x), radius })
    }

    /// Middle of the segment, and the distance from there that nothing exceeds (m).
    pub(crate) fn ball(&self) -> (Vector3<f64>, f64) {
        let (from, to) = (Vector3::from(self.from), Vector3::from(self.to));
        ((from + to) / 2.0, (to - from).norm() / 2.0 + self.radius)
    }
}

/// The shortest rotation that takes the unit vector `axis` to x [Rodrigues' formula], without an angle: the same bits everywhere.
fn turn_to_x(axis: &Vector3<f64>) -> Matrix3<f64> {
    let cos = axis.x;
    if cos < -1.0 + 1e-6 {
        // All but a half turn: first half a turn about z, then the small rest.
        let half = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
        return turn_to_x(&(half * axis)) * half;
    }
    let cross = axis.cross(&Vector3::x()).cross_matrix();
    Matrix3::identity() + cross + cross * cross / (1.0 + cos)
}

impl<S: Real> Bound<S> {
    /// The same in another scalar.
    pub(crate) fn new(bound: &Bound<f64>) -> Self {
        Self {
            from: bound.from.map(S::splat),
            to: bound.to.map(S::splat),
            radius: S::splat(bound.radius),
        }
    }

    /// A capsule around a shape: itself, if it is one.
    #[inline(always)]
    pub(crate) fn of(shape: &Rounded<S>) -> Self {
        match shape.core {
            Core::Segment { from, to } => Self { from, to, radius: shape.radius },
            Core::Cylinder { centre, axis, radius, half } => Self {
                from: mul_add(-half, axis, centre),
                to: mul_add(half, axis, centre),
                radius: radius + shape.radius,
            },
        }
    }

    /// The capsule in the base frame, given its body's pose.
    #[inline(always)]
    pub(crate) fn placed(&self, r: &Mat3<S>, o: Vec3<S>) -> Self {
        Self {
            from: add(mat_vec(r, self.from), o),
            to: add(mat_vec(r, self.to), o),
            radius: self.radius,
        }
    }

    /// Middle of the segment.
    #[inline(always)]
    pub(crate) fn middle(&self) -> Vec3<S> {
        scale(S::splat(0.5), add(self.from, self.to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_axis_turns_to_x() {
        let mut axes = vec![Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::z()];
        axes.extend([1e-3, -1e-4, 1e-9].map(|y| Vector3::new(-1.0, y, 0.5 * y).normalize()));
        axes.extend([0.3, -0.9].map(|x| Vector3::new(x, 0.5, -0.7).normalize()));
        for axis in axes {
            let turn = turn_to_x(&axis);
            assert!((turn * axis - Vector3::x()).norm() < 1e-9, "{axis}");
            assert!((turn * turn.transpose() - Matrix3::identity()).norm() < 1e-9, "{axis}");
            assert!((turn.determinant() - 1.0).abs() < 1e-9, "{axis}");
        }
    }
}
