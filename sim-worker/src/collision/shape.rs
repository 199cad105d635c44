//! Convex shapes as a core and a radius around it, and where they stand.

use crate::robot::Shape;
use crate::scalar::Real;
use crate::spatial::{Mat3, Vec3, add, mat_vec};

/// Core of a shape, in the frame of its body or, once placed, of the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Core<S> {
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
pub(crate) struct Rounded<S> {
    pub(crate) core: Core<S>,
    pub(crate) radius: S,
}

/// A box fixed to the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FixedBox<S> {
    pub(crate) centre: Vec3<S>,
    /// Box axes to base axes.
    pub(crate) rotation: Mat3<S>,
    pub(crate) half: Vec3<S>,
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

/// Centre and radius of a sphere that holds the shapes.
pub(crate) fn bounding_sphere(shapes: &[Shape]) -> Option<(nalgebra::Vector3<f64>, f64)> {
    let balls: Vec<(nalgebra::Vector3<f64>, f64)> = shapes
        .iter()
        .flat_map(|shape| match shape {
            Shape::Capsule { from, to, radius } => vec![(*from, *radius), (*to, *radius)],
            Shape::Disc { centre, radius, half_height, .. } => {
                vec![(*centre, radius.hypot(*half_height))]
            }
        })
        .collect();
    let first = balls.first()?.0;
    let (mut low, mut high) = (first, first);
    for (c, r) in &balls {
        low = low.inf(&c.add_scalar(-r));
        high = high.sup(&c.add_scalar(*r));
    }
    let centre = (low + high) / 2.0;
    let radius = balls.iter().map(|(c, r)| (c - centre).norm() + r).fold(0.0, f64::max);
    Some((centre, radius))
}
