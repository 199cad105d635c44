//! Joint angles that put an arm's hand at a pose, in all the arm's ways.
//!
//! Damped least squares [Nakamura and Hanafusa 1986; Wampler 1986] with a damping that falls with
//! the error [Chan and Lawrence 1988], from many starts: it asks nothing of the arm but its Jacobian,
//! so robots of one's own are served as well, and where no joint angles reach the pose it ends at
//! those that come nearest.

use std::f64::consts::{PI, TAU};

use nalgebra::{
    Isometry3, Matrix3, Matrix6, Quaternion, Rotation3, SMatrix, Translation3, UnitQuaternion,
    Vector3, Vector6,
};

use crate::robot::{MAX_JOINTS_PER_ARM, Robot};
use crate::state::State;

/// Joint angles of an arm (rad), or what else belongs to its joints; zero behind its last.
pub(crate) type Angles = [f64; MAX_JOINTS_PER_ARM];

/// How a hand's pose changes with the joint angles of its arm; zero behind its last joint.
pub(crate) type Jacobian = SMatrix<f64, 6, MAX_JOINTS_PER_ARM>;

/// What belongs to the joints of an arm, in an array that has room for every arm.
pub(crate) fn padded(values: &[f64]) -> Angles {
    let mut padded = [0.0; MAX_JOINTS_PER_ARM];
    padded[..values.len()].copy_from_slice(values);
    padded
}

/// A pose in the world from position (m) and Euler angles (rad), R = Rx Ry Rz.
pub(crate) fn pose([x, y, z, a, b, c]: [f64; 6]) -> Isometry3<f64> {
    let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
    let rotation =
        about(Vector3::x_axis(), a) * about(Vector3::y_axis(), b) * about(Vector3::z_axis(), c);
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from(rotation))
}

/// Where the base is in the world.
pub(crate) fn base_pose(state: &State<f64>) -> Isometry3<f64> {
    placed(state.base_position, state.base_quaternion)
}

/// A pose from position (m) and attitude (w, x, y, z).
pub(crate) fn placed(position: [f64; 3], [w, x, y, z]: [f64; 4]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Translation3::from(Vector3::from(position)), rotation)
}

/// Starts beside home.
const STARTS: u64 = 64;
/// Iterations from each of them.
const ITERATIONS: usize = 60;
/// Longest change of a joint in an iteration (rad).
const LONGEST: f64 = 0.5;
/// Residual (m and rad, together) above which an end is no candidate: the base may move a hand by
/// so much.
const NEAR: f64 = 0.2;
/// Residual below which an end is a solution.
const EXACT: f64 = 1e-6;
/// Ends that differ by less in every joint (rad) are the same.
const SAME: f64 = 0.05;
/// Primes whose radical inverses are the starts [Halton 1960].
const PRIMES: [u64; MAX_JOINTS_PER_ARM] = [2, 3, 5, 7, 11, 13, 17];

fn isometry(rotation: &Matrix3<f64>, position: Vector3<f64>) -> Isometry3<f64> {
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    Isometry3::from_parts(Translation3::from(position), rotation)
}

/// Pose of the hand in the base frame, and how it changes with the joint angles: rows linear (m/rad),
/// then angular (rad/rad), base axes.
pub(crate) fn forward(robot: &Robot, arm: usize, q: &Angles) -> (Isometry3<f64>, Jacobian) {
    let (mount, kind) = (&robot.arms[arm], robot.type_of(arm));
    let (mut r, mut o) = (mount.rotation, mount.position);
    let mut joints = Vec::with_capacity(kind.links.len());
    let mut hand = (r, o);
    for (link, &q) in kind.links.iter().zip(q) {
        r *= Rotation3::from_axis_angle(&Vector3::z_axis(), q).matrix();
        joints.push((r.column(2).into_owned(), o));
        hand = (r * kind.tool_rotation, o + r * kind.tool_position);
        o += r * link.shift;
        r *= link.twist;
    }
    let mut jacobian = Jacobian::zeros();
    for (j, (axis, origin)) in joints.iter().enumerate() {
        jacobian.fixed_view_mut::<3, 1>(0, j).copy_from(&axis.cross(&(hand.1 - origin)));
        jacobian.fixed_view_mut::<3, 1>(3, j).copy_from(axis);
    }
    (isometry(&hand.0, hand.1), jacobian)
}

/// How far the hand is from `target`: linear (m) and rotation vector (rad), base axes.
pub(crate) fn residual(target: &Isometry3<f64>, hand: &Isometry3<f64>) -> Vector6<f64> {
    let linear = target.translation.vector - hand.translation.vector;
    let angular = (target.rotation * hand.rotation.inverse()).scaled_axis();
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// At most `iterations` steps from `q` towards `target` (base frame); the angles, and the length of
/// the residual before the last step.
pub(crate) fn approach(
    robot: &Robot,
    arm: usize,
    target: &Isometry3<f64>,
    mut q: Angles,
    iterations: usize,
) -> (Angles, f64) {
    let mut left = f64::INFINITY;
    for _ in 0..iterations {
        let (hand, jacobian) = forward(robot, arm, &q);
        let error = residual(target, &hand);
        left = error.norm();
        if left < 1e-9 {
            break;
        }
        let damping = 1e-2 * left.powi(2) + 1e-8;
        let square = jacobian * jacobian.transpose() + Matrix6::identity() * damping;
        let Some(inverse) = square.try_inverse() else { break };
        let step = jacobian.transpose() * (inverse * error);
        let shorten = (LONGEST / step.amax()).min(1.0);
        for (angle, change) in q.iter_mut().zip(step.iter()) {
            *angle += shorten * change;
        }
    }
    (q, left)
}

/// Radical inverse of `index` in base `prime`, in [0, 1).
fn radical_inverse(mut index: u64, prime: u64) -> f64 {
    let (mut inverse, mut digit) = (0.0, 1.0);
    while index > 0 {
        digit /= prime as f64;
        inverse += digit * (index % prime) as f64;
        index /= prime;
    }
    inverse
}

/// Where the search for joint angles begins: at home, then all over the half turns around it.
fn starts(home: &[f64]) -> impl Iterator<Item = Angles> {
    let home = home.to_vec();
    let first = padded(&home);
    let others = (1..=STARTS).map(move |start| {
        let mut q = padded(&home);
        for (q, prime) in q[..home.len()].iter_mut().zip(PRIMES) {
            *q += TAU * radical_inverse(start, prime) - PI;
        }
        q
    });
    std::iter::once(first).chain(others)
}

/// Whether some joint angles bring the hand of `arm` to `target` (base frame).
pub(crate) fn solvable(robot: &Robot, arm: usize, target: &Isometry3<f64>) -> bool {
    let solves = |q| approach(robot, arm, target, q, ITERATIONS).1 < EXACT;
    starts(&robot.arms[arm].home).any(solves)
}

/// Joint angles that bring the hand of `arm` to `target` (base frame) or near it, each joint within
/// half a turn of home: solutions first, then near misses, of each those nearer to home first.
pub(crate) fn candidates(robot: &Robot, arm: usize, target: &Isometry3<f64>) -> Vec<Angles> {
    let home = &robot.arms[arm].home;
    let mut found: Vec<(Angles, bool, f64)> = Vec::new();
    for q in starts(home) {
        let (mut q, left) = approach(robot, arm, target, q, ITERATIONS);
        if left > NEAR {
            continue;
        }
        for (angle, home) in q.iter_mut().zip(home) {
            *angle = home + (*angle - home + PI).rem_euclid(TAU) - PI;
        }
        let same = |other: &Angles| q.iter().zip(other).all(|(a, b)| (a - b).abs() < SAME);
        if !found.iter().any(|(other, ..)| same(other)) {
            let turn = q.iter().zip(home).map(|(a, h)| (a - h).abs()).fold(0.0, f64::max);
            found.push((q, left > EXACT, turn));
        }
    }
    found.sort_by(|a, b| a.1.cmp(&b.1).then(a.2.total_cmp(&b.2)));
    found.into_iter().map(|(q, ..)| q).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jacobian_is_the_derivative_of_the_pose() {
        let text = include_str!("../robots/seven-joints.toml");
        let robot = Robot::from_toml(text, std::path::Path::new("robot.toml")).expect("valid");
        let q = [0.3, -1.1, 0.7, -0.4, 1.2, 0.5, -0.8];
        let h = 1e-6;
        // Of the arms the second has six joints, the third seven.
        for (arm, joints) in [(1, 6), (2, 7)] {
            let q = padded(&q[..joints]);
            let (_, jacobian) = forward(&robot, arm, &q);
            for j in 0..joints {
                let at = |change: f64| {
                    let mut q = q;
                    q[j] += change;
                    forward(&robot, arm, &q).0
                };
                let slope = residual(&at(h), &at(-h)) / (2.0 * h);
                // Central differences err by h² and by rounding, 1e-16 / h.
                assert!((jacobian.column(j) - slope).amax() < 1e-8, "arm {arm}, joint {j}");
            }
            assert!(jacobian.columns_range(joints..).iter().all(|&x| x == 0.0));
        }
    }

    #[test]
    fn every_way_to_a_pose_leads_there_and_the_known_one_is_among_them() {
        let robot = Robot::builtin("paper").expect("built in");
        for arm in 0..robot.n_arms {
            let mut q = padded(&robot.arms[arm].home);
            for (angle, change) in q.iter_mut().zip([0.4, -0.3, 0.6, 0.2, 0.5, -0.4]) {
                *angle += change;
            }
            let target = forward(&robot, arm, &q).0;
            let ways = candidates(&robot, arm, &target);
            let is_q = |way: &Angles| way.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-6);
            assert!(ways.iter().any(is_q), "arm {arm}");
            assert!(solvable(&robot, arm, &target), "arm {arm}");
            let exact = ways
                .iter()
                .filter(|way| residual(&target, &forward(&robot, arm, way).0).norm() < 1e-6)
                .count();
            // Shoulder, elbow and wrist may each be flipped: up to eight ways for such an arm.
            assert!((2..=8).contains(&exact), "arm {arm}: {exact} of {}", ways.len());
        }
    }

    #[test]
    fn a_pose_from_angles_has_those_angles() {
        let angles = [0.7, -0.4, 1.1];
        let [a, b, c] = angles;
        let rotation = pose([1.0, 2.0, 3.0, a, b, c]).rotation.to_rotation_matrix();
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation.matrix()[(i, j)]));
        for (found, angle) in crate::spatial::euler_xyz(&rows).iter().zip(angles) {
            assert!((found - angle).abs() < 1e-12);
        }
    }

    #[test]
    fn a_pose_out_of_reach_has_no_candidate() {
        let robot = Robot::builtin("paper").expect("built in");
        let mut target = forward(&robot, 0, &padded(&robot.arms[0].home)).0;
        target.translation.vector.y += 3.0;
        assert!(candidates(&robot, 0, &target).is_empty());
        assert!(!solvable(&robot, 0, &target));
    }

    /// The wrist's centre keeps at least the 93 mm of its third link's offset from the first joint's axis.
    #[test]
    fn a_wrist_cannot_enter_the_cylinder_around_its_first_joint() {
        let robot = Robot::builtin("paper").expect("built in");
        for arm in 0..robot.n_arms {
            let mount = &robot.arms[arm];
            let axis = mount.rotation.column(2).into_owned();
            let hand = forward(&robot, arm, &padded(&mount.home)).0;
            let centre = |hand: &Isometry3<f64>| {
                hand.translation.vector
                    - hand.rotation * Vector3::z() * robot.type_of(arm).tool_position.z
            };
            let from_axis = |centre: Vector3<f64>| {
                let offset = centre - mount.position;
                offset - axis * axis.dot(&offset)
            };
            let radius = from_axis(centre(&hand)).norm();
            assert!((radius - 0.093).abs() < 1e-3, "at home on the cylinder: {radius}");
            // Lower by 0.25 m, where the elbow has room to fold, and nearer to or further from the axis.
            for (share, within_reach) in [(0.7, false), (1.3, true)] {
                let mut target = hand;
                let out = from_axis(centre(&hand));
                target.translation.vector += out * (share - 1.0) - axis * 0.25;
                assert_eq!(solvable(&robot, arm, &target), within_reach, "arm {arm}, {share}");
            }
        }
    }
}
