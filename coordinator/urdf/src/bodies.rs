//! Masses and shapes of what is fixed together, in a frame of ours.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point3, SymmetricEigen, Vector3};
use simulator::robot::description::{BoxDescription, CapsuleDescription, DiscDescription};

use crate::document::Geometry;
use crate::tree::Body;

/// Lengths below this are zero (m).
const ZERO: f64 = 1e-6;

/// A mass, its centre, and its inertia about that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Solid {
    pub(crate) mass: f64,
    pub(crate) com: Vector3<f64>,
    pub(crate) inertia: Matrix3<f64>,
}

impl Solid {
    /// Of all links together, in `frame`; none if they have none.
    pub(crate) fn of(body: &Body<'_>, frame: &Isometry3<f64>) -> Option<Self> {
        let parts: Vec<(f64, Isometry3<f64>, Matrix3<f64>)> = body
            .iter()
            .filter_map(|(link, pose)| {
                let inertial = link.inertial.as_ref().filter(|inertial| inertial.mass > 0.0)?;
                let pose = frame.inverse() * pose * inertial.origin;
                Some((inertial.mass, pose, inertial.inertia))
            })
            .collect();
        let mass: f64 = parts.iter().map(|(mass, ..)| mass).sum();
        if parts.is_empty() {
            return None;
        }
        let com: Vector3<f64> = parts
            .iter()
            .map(|(mass, pose, _)| pose.translation.vector * *mass)
            .sum::<Vector3<f64>>()
            / mass;
        let inertia = parts
            .iter()
            .map(|(mass, pose, inertia)| {
                let turn = pose.rotation.to_rotation_matrix();
                let away = pose.translation.vector - com;
                let of_point = Matrix3::identity() * away.norm_squared() - away * away.transpose();
                turn * inertia * turn.transpose() + of_point * *mass
            })
            .sum();
        Some(Self { mass, com, inertia })
    }

    /// xx, yy, zz, xy, xz, yz.
    pub(crate) fn elements(&self) -> [f64; 6] {
        let i = &self.inertia;
        [i[(0, 0)], i[(1, 1)], i[(2, 2)], i[(0, 1)], i[(0, 2)], i[(1, 2)]]
    }

    /// The solid box with this mass, centre and inertia; none if there is none, because a moment is no less than the two others together.
    pub(crate) fn equivalent_box(&self, name: &str) -> Option<BoxDescription> {
        let largest = self.inertia.diagonal().max();
        let [_, _, _, xy, xz, yz] = self.elements();
        // Of a square base every axis across is a principal one; products of inertia that are rounding would turn it by an eighth.
        let straight = [xy, xz, yz].iter().all(|product| product.abs() < 1e-6 * largest);
        let (axes, moments) = if straight {
            (Matrix3::identity(), self.inertia.diagonal())
        } else {
            let eigen = SymmetricEigen::new(self.inertia);
            (eigen.eigenvectors, eigen.eigenvalues)
        };
        let moments: [f64; 3] = moments.into();
        let sum: f64 = moments.iter().sum();
        let squares = moments.map(|moment| 6.0 * (sum - 2.0 * moment) / self.mass);
        // An edge of a millimetre at least.
        if squares.iter().any(|&square| square < 1e-6) {
            return None;
        }
        let (turn, order) = least_turned(axes);
        Some(BoxDescription {
            name: name.to_owned(),
            size: order.map(|axis| squares[axis].sqrt()),
            mass: self.mass,
            position: self.com.into(),
            euler_deg: euler_deg(&turn),
        })
    }
}

/// Of the 24 ways to name and point the axes of a box, the one that is turned least; and which axis comes first, second, third.
fn least_turned(axes: Matrix3<f64>) -> (Matrix3<f64>, [usize; 3]) {
    const ORDERS: [[usize; 3]; 6] =
        [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let mut best = (f64::NEG_INFINITY, axes, ORDERS[0]);
    for order in ORDERS {
        for signs in 0..8_u8 {
            let column =
                |i: usize| axes.column(order[i]) * if signs >> i & 1 == 1 { -1.0 } else { 1.0 };
            let turned = Matrix3::from_columns(&[column(0), column(1), column(2)]);
            if turned.determinant() > 0.0 && turned.trace() > best.0 + 1e-9 {
                best = (turned.trace(), turned, order);
            }
        }
    }
    (best.1, best.2)
}

/// Intrinsic x-y-z angles (degrees), right angles exact.
pub(crate) fn euler_deg(rotation: &Matrix3<f64>) -> [f64; 3] {
    let r = |row: usize, column: usize| rotation[(row, column)];
    // R = Rx(a) Ry(b) Rz(c).
    let b = r(0, 2).clamp(-1.0, 1.0).asin();
    let [a, c] = if r(0, 2).abs() < 1.0 - 1e-12 {
        [(-r(1, 2)).atan2(r(2, 2)), (-r(0, 1)).atan2(r(0, 0))]
    } else {
        [r(2, 1).atan2(r(1, 1)), 0.0]
    };
    [a, b, c].map(|angle| {
        let degrees = angle.to_degrees();
        let rounded = degrees.round();
        if (degrees - rounded).abs() < 1e-6 { rounded + 0.0 } else { degrees }
    })
}

/// Shapes of a link by which contacts are found.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Shapes {
    pub(crate) capsules: Vec<CapsuleDescription>,
    pub(crate) discs: Vec<DiscDescription>,
    /// What was taken for something else or left out, and how often.
    pub(crate) notes: BTreeMap<&'static str, usize>,
}

impl Shapes {
    /// Of all links together, in `frame`.
    pub(crate) fn of(body: &Body<'_>, frame: &Isometry3<f64>) -> Self {
        let mut shapes = Self::default();
        let placed: Vec<(Isometry3<f64>, Geometry)> = body
            .iter()
            .flat_map(|(link, pose)| {
                let at = frame.inverse() * pose;
                link.collisions.iter().map(move |part| (at * part.origin, part.geometry))
            })
            .collect();
        // Balls that are the ends of capsules.
        let mut ends = vec![false; placed.len()];
        for (pose, geometry) in &placed {
            let Geometry::Cylinder { radius, length } = *geometry else { continue };
            let half = pose.rotation * Vector3::z() * (length / 2.0);
            let centre = pose.translation.vector;
            let balls = [centre - half, centre + half].map(|end| {
                placed.iter().position(|(at, other)| {
                    matches!(other, Geometry::Sphere { radius: r } if (r - radius).abs() < ZERO)
                        && (at.translation.vector - end).norm() < ZERO
                })
            });
            if let [Some(from), Some(to)] = balls {
                (ends[from], ends[to]) = (true, true);
                shapes.capsule(centre - half, centre + half, radius);
            } else {
                shapes.cylinder(pose, radius, length);
            }
        }
        for ((pose, geometry), _) in placed.iter().zip(ends).filter(|(_, is_end)| !is_end) {
            match *geometry {
                Geometry::Cylinder { .. } => {}
                Geometry::Sphere { radius } => {
                    let centre = pose.translation.vector;
                    shapes.capsule(centre, centre, radius);
                }
                Geometry::Box { size } => shapes.solid(pose, size),
                Geometry::Mesh => {
                    shapes.note("a mesh is left out: draw a cylinder or a box for it");
                }
            }
        }
        shapes
    }

    fn note(&mut self, what: &'static str) {
        *self.notes.entry(what).or_default() += 1;
    }

    fn capsule(&mut self, from: Vector3<f64>, to: Vector3<f64>, radius: f64) {
        self.capsules.push(CapsuleDescription { from: from.into(), to: to.into(), radius });
    }

    fn cylinder(&mut self, pose: &Isometry3<f64>, radius: f64, length: f64) {
        let axis = pose.rotation * Vector3::z();
        let centre = pose.translation.vector;
        if axis.xy().norm() < ZERO && centre.xy().norm() < ZERO {
            let (low, high) = (centre.z - length / 2.0, centre.z + length / 2.0);
            self.discs.push(DiscDescription { radius, z: [low, high] });
            return;
        }
        if length < 2.0 * radius {
            // Its rim is where it is: a ring of capsules as thick as it is.
            self.note("a flat cylinder that is not about the next joint's axis is taken for four crossed capsules");
            let (thick, reach) = (length / 2.0, radius - length / 2.0);
            for turn in 0..4 {
                let (sine, cosine) = (f64::from(turn) * std::f64::consts::FRAC_PI_4).sin_cos();
                let rim = pose.rotation * Vector3::new(cosine, sine, 0.0) * reach;
                self.capsule(centre - rim, centre + rim, thick);
            }
            return;
        }
        self.note("a cylinder that is not about the next joint's axis is taken for a capsule, which is round at its ends");
        let half = axis * (length / 2.0 - radius);
        self.capsule(centre - half, centre + half, radius);
    }

    fn solid(&mut self, pose: &Isometry3<f64>, size: [f64; 3]) {
        self.note("a box of an arm is taken for the capsule along its longest edge");
        let longest =
            (0..3).fold(0, |longest, axis| if size[axis] > size[longest] { axis } else { longest });
        let others = (size.iter().sum::<f64>() - size[longest]) / 4.0;
        let half = (size[longest] / 2.0 - others).max(0.0);
        let end = |side: f64| {
            let mut end = Point3::origin();
            end[longest] = side * half;
            (pose * end).coords
        };
        self.capsule(end(-1.0), end(1.0), others);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    #[test]
    fn a_box_comes_back_from_its_inertia() {
        let size = [0.4_f64, 1.0, 0.2];
        let [x, y, z] = size.map(|edge| edge * edge);
        let inertia = Matrix3::from_diagonal(&Vector3::new(y + z, x + z, x + y)) * (50.0 / 12.0);
        let turn = Rotation3::from_euler_angles(0.2, -0.1, 0.3).into_inner();
        let com = Vector3::new(1.0, 2.0, 3.0);
        let mass = Solid { mass: 50.0, com, inertia: turn * inertia * turn.transpose() };
        let solid = mass.equivalent_box("base").expect("a box");
        assert!(solid.size.iter().zip(size).all(|(a, b)| (a - b).abs() < 1e-9), "{:?}", solid.size);
        assert_eq!(solid.position, [1.0, 2.0, 3.0]);
        let [a, b, c] = solid.euler_deg.map(f64::to_radians);
        let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
        let turned =
            about(Vector3::x_axis(), a) * about(Vector3::y_axis(), b) * about(Vector3::z_axis(), c);
        let back = turned * inertia * turned.transpose();
        assert!((back - mass.inertia).norm() < 1e-9, "{:?}", solid.euler_deg);
        let noise = Matrix3::new(0.0, 1e-9, 0.0, 1e-9, 0.0, 0.0, 0.0, 0.0, 0.0);
        let square =
            Solid { inertia: Matrix3::from_diagonal(&Vector3::new(8.0, 8.0, 9.0)) + noise, ..mass };
        assert_eq!(square.equivalent_box("base").expect("a box").euler_deg, [0.0; 3]);
        let rod = Solid { inertia: Matrix3::from_diagonal(&Vector3::new(0.0, 1.0, 1.0)), ..mass };
        assert!(rod.equivalent_box("base").is_none(), "a line is no box");
    }

    #[test]
    fn angles_give_back_the_rotation() {
        for angles in
            [[10.0, 20.0, 30.0], [180.0, 0.0, -90.0], [0.0, 90.0, 0.0], [25.0, -90.0, 0.0]]
        {
            let [a, b, c] = angles.map(f64::to_radians);
            let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
            let rotation = about(Vector3::x_axis(), a)
                * about(Vector3::y_axis(), b)
                * about(Vector3::z_axis(), c);
            let found = euler_deg(rotation.matrix());
            assert!(found.iter().zip(angles).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        }
    }
}
