//! Denavit–Hartenberg rows of an arm's axes.
//!
//! Standard rows (Denavit and Hartenberg 1955; as in Siciliano et al., *Robotics*, section 2.8.2): frame i stands where the common normal of
//! axes i and i+1 meets axis i+1, which is its z axis; its x axis is along that normal.
//!
//! Nothing depends on where the arm stands: arms that are alike get the same rows.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use simulator::robot::description::DhRow;

use crate::tree::Axis;

/// Lengths below this are zero (m).
const ZERO: f64 = 1e-7;
/// Sines below this are zero: many files write 1.57 for a right angle, and the common normal of almost parallel axes is far away.
const PARALLEL: f64 = 2e-3;
/// Sines below this are rounding, of which nothing is said.
const ROUNDING: f64 = 1e-5;
/// Degrees below this are the calculation's.
const NOISE_DEG: f64 = 1e-6;

/// An arm's rows, and its frames while the URDF's angles are zero.
#[derive(Debug, Clone)]
pub(crate) struct Chain {
    pub(crate) rows: Vec<DhRow>,
    /// Angles of ours while the URDF's are zero (rad), in (−π, π].
    pub(crate) zeros: Vec<f64>,
    /// Frame 0 and those of the rows.
    pub(crate) frames: Vec<Isometry3<f64>>,
    /// The hand's turn against the last frame that no row can hold (rad).
    pub(crate) left_over: f64,
    /// By how much axes that were taken for parallel are not, the worst of them (rad).
    pub(crate) straightened: f64,
}

/// A point and a direction.
#[derive(Clone, Copy)]
struct Line {
    point: Vector3<f64>,
    along: Vector3<f64>,
}

impl Line {
    fn of(axis: &Axis<'_>) -> Self {
        Self { point: axis.pose.translation.vector, along: axis.direction.into_inner() }
    }

    fn nearest_to(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.point + self.along * (point - self.point).dot(&self.along)
    }
}

/// The rows of `joints`, the last one such that its frame is as near to `hand` as it can be.
pub(crate) fn chain(joints: &[Axis<'_>], hand: &Isometry3<f64>) -> Chain {
    let lines: Vec<Line> = joints.iter().map(Line::of).collect();
    let last = lines.len() - 1;
    // Of the rows' frames: x axes and origins. Frame 0 has the x axis of frame 1, so that the first angle is zero there.
    let mut x = vec![Vector3::zeros(); last + 2];
    let mut origin = vec![lines[0].point; last + 2];
    for i in 1..=last {
        let (this, next) = (lines[i - 1], lines[i]);
        (x[i], origin[i]) = common_normal(this, next, &origin[i - 1]).unwrap_or_else(|| {
            // The same line twice: as before it.
            let before = if i > 1 { x[i - 1] } else { across(&joints[0]) };
            (before, origin[i - 1])
        });
    }
    x[0] = x[1];
    let axis = lines[last].along;
    let turned = hand.rotation.to_rotation_matrix();
    let (hand_x, hand_z) = (turned * Vector3::x(), turned * Vector3::z());
    let across = axis.cross(&hand_z);
    let across = if across.dot(&hand_x) < 0.0 { -across } else { across };
    x[last + 1] = if across.norm() > PARALLEL { across.normalize() } else { hand_x };
    let last_z = if across.norm() > PARALLEL { hand_z } else { axis * axis.dot(&hand_z).signum() };
    origin[last + 1] =
        Line { point: origin[last], along: axis }.nearest_to(&hand.translation.vector);

    let z = |i: usize| lines.get(i).map_or(last_z, |line| line.along);
    let zeros = (0..=last).map(|i| angle(&z(i), &x[i], &x[i + 1])).collect();
    let rows = (0..=last).map(|i| {
        let along = z(i);
        let shift = origin[i + 1] - origin[i];
        let alpha = angle(&x[i + 1], &along, &z(i + 1));
        DhRow {
            a: tidy(shift.dot(&x[i + 1])),
            d: tidy(shift.dot(&along)),
            alpha_deg: tidy_degrees(alpha.to_degrees()),
        }
    });
    let frames = (0..=last + 1).map(|i| {
        // Across the axis to the last digit, also where one was taken for parallel.
        let z = z(i);
        let y = z.cross(&x[i]).normalize();
        let rotation = Matrix3::from_columns(&[y.cross(&z), y, z]);
        let rotation = Rotation3::from_matrix_unchecked(rotation);
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
        Isometry3::from_parts(Translation3::from(origin[i]), rotation)
    });
    let left_over = angle(&last_z, &x[last + 1], &hand_x);
    let sines = lines.windows(2).map(|pair| pair[0].along.cross(&pair[1].along).norm());
    let taken = sines.filter(|&sine| (ROUNDING..PARALLEL).contains(&sine));
    let straightened = taken.fold(0.0, f64::max);
    Chain { rows: rows.collect(), zeros, frames: frames.collect(), left_over, straightened }
}

/// Direction from a line to the next along their common normal, and where it meets the next; of parallel lines the normal through
/// `from`. None if they are one line.
fn common_normal(
    this: Line,
    next: Line,
    from: &Vector3<f64>,
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let across = this.along.cross(&next.along);
    let sine = across.norm();
    if sine < PARALLEL {
        let foot = next.nearest_to(from);
        let way = foot - from;
        let way = way - this.along * way.dot(&this.along);
        return (way.norm() > ZERO).then(|| (way.normalize(), foot));
    }
    let across = across / sine;
    let between = next.point - this.point;
    // Where the next line comes nearest to this one.
    let foot = next.point + next.along * (between.cross(&this.along).dot(&across) / sine);
    let distance = between.dot(&across);
    let towards = if distance < -ZERO { -across } else { across };
    Some((towards, foot))
}

/// A direction across the first joint's axis that turns with the arm.
fn across(joint: &Axis<'_>) -> Vector3<f64> {
    let axis = joint.direction.into_inner();
    let candidates = [Vector3::x(), Vector3::y(), Vector3::z()].map(|v| joint.pose.rotation * v);
    let across = candidates.map(|v| v - axis * v.dot(&axis));
    across.into_iter().find(|v| v.norm() > 0.5).unwrap_or(across[0]).normalize()
}

/// Angle about `axis` from one direction across it to another, in (−π, π].
fn angle(axis: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>) -> f64 {
    let angle = from.cross(to).dot(axis).atan2(from.dot(to));
    // Half a turn either way is one angle.
    if angle < -PI + 1e-9 { angle + 2.0 * PI } else { angle }
}

/// Without the noise of the calculation.
fn tidy(x: f64) -> f64 {
    let rounded = (x * 1e9).round() / 1e9;
    if (x - rounded).abs() < 1e-12 { rounded + 0.0 } else { x }
}

/// Likewise, of degrees.
fn tidy_degrees(x: f64) -> f64 {
    let rounded = x.round();
    if (x - rounded).abs() < NOISE_DEG { rounded + 0.0 } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(point: [f64; 3], along: [f64; 3]) -> Line {
        Line { point: point.into(), along: Vector3::from(along).normalize() }
    }

    #[test]
    fn the_common_normal_meets_both_lines_at_right_angles() {
        let (this, next) =
            (line([1.0, 2.0, 3.0], [0.3, -0.4, 1.0]), line([-2.0, 0.5, 1.0], [1.0, 0.2, 0.1]));
        let (x, foot) = common_normal(this, next, &this.point).expect("skew");
        assert!(x.dot(&this.along).abs() < 1e-12 && x.dot(&next.along).abs() < 1e-12);
        assert!((next.nearest_to(&foot) - foot).norm() < 1e-12, "on the next line");
        let way = foot - this.nearest_to(&foot);
        assert!((way.normalize() - x).norm() < 1e-9, "{way} is along {x}");
    }

    #[test]
    fn lines_that_meet_have_a_normal_of_no_length() {
        let (this, next) =
            (line([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]), line([0.0, 0.0, 3.0], [0.0, 1.0, 0.0]));
        let (x, foot) = common_normal(this, next, &this.point).expect("they cross");
        assert!((x - Vector3::new(-1.0, 0.0, 0.0)).norm() < 1e-12, "{x}");
        assert!((foot - Vector3::new(0.0, 0.0, 3.0)).norm() < 1e-12, "{foot}");
    }

    #[test]
    fn of_parallel_lines_the_normal_begins_where_the_frame_is() {
        let (this, next) =
            (line([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), line([0.5, 0.0, 7.0], [0.0, 0.0, -1.0]));
        let from = Vector3::new(0.0, 0.0, 2.0);
        let (x, foot) = common_normal(this, next, &from).expect("apart");
        assert_eq!((x, foot), (Vector3::x(), Vector3::new(0.5, 0.0, 2.0)));
        assert!(common_normal(this, this, &from).is_none(), "one line");
    }
}
