//! In which axes a pose is given.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};

use crate::inverse_kinematics::{base_pose, forward, padded, pose};
use crate::robot::Robot;
use crate::spatial::euler_xyz;
use crate::state::State;

/// Axes and origin of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// The world.
    World,
    /// The base.
    Base,
    /// The mount of the arm, where its first joint is.
    Mount,
}

impl Frame {
    fn placed(self, robot: &Robot, state: &State<f64>, arm: usize) -> Isometry3<f64> {
        let mount = || {
            let arm = &robot.arms[arm];
            let rotation = UnitQuaternion::from_matrix(&arm.rotation);
            Isometry3::from_parts(Translation3::from(arm.position), rotation)
        };
        match self {
            Self::World => Isometry3::identity(),
            Self::Base => base_pose(state),
            Self::Mount => base_pose(state) * mount(),
        }
    }

    /// A pose in these axes in the world's: position (m) and Euler angles (rad), both ways.
    pub fn to_world(
        self,
        robot: &Robot,
        state: &State<f64>,
        arm: usize,
        numbers: [f64; 6],
    ) -> [f64; 6] {
        numbers_of(&(self.placed(robot, state, arm) * pose(numbers)))
    }

    /// The hand's present pose moved along these axes (m) and turned about them (Euler angles, rad), in the world.
    pub fn by(self, robot: &Robot, state: &State<f64>, arm: usize, numbers: [f64; 6]) -> [f64; 6] {
        let axes = self.placed(robot, state, arm).rotation;
        let hand = hand(robot, state, arm);
        let change = pose(numbers);
        let shift = axes * change.translation.vector;
        let rotation = axes * change.rotation * axes.inverse() * hand.rotation;
        let translation = Translation3::from(hand.translation.vector + shift);
        numbers_of(&Isometry3::from_parts(translation, rotation))
    }
}

/// Where a hand is: position (m) and Euler angles (rad) in the world.
pub fn hand_pose(robot: &Robot, state: &State<f64>, arm: usize) -> [f64; 6] {
    numbers_of(&hand(robot, state, arm))
}

pub(super) fn hand(robot: &Robot, state: &State<f64>, arm: usize) -> Isometry3<f64> {
    let q = padded(&state.q[robot.joints.of_arm(arm)]);
    base_pose(state) * forward(robot, arm, &q).0
}

fn numbers_of(pose: &Isometry3<f64>) -> [f64; 6] {
    let rotation = pose.rotation.to_rotation_matrix();
    let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation.matrix()[(i, j)]));
    let [a, b, c] = euler_xyz(&rows);
    let p = pose.translation.vector;
    [p.x, p.y, p.z, a, b, c]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_the_same_in_any_axes() {
        let robot = Robot::builtin("paper").expect("built in");
        let mut state = State::home(&robot);
        let turned = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.5);
        state.base_quaternion = [turned.w, turned.i, turned.j, turned.k];
        state.base_position = [0.1, 0.2, 0.3];
        for arm in 0..robot.n_arms {
            let known = hand(&robot, &state, arm);
            for frame in [Frame::World, Frame::Base, Frame::Mount] {
                let inside = frame.placed(&robot, &state, arm).inverse() * known;
                let back = frame.to_world(&robot, &state, arm, numbers_of(&inside));
                let off = pose(back).translation.vector - known.translation.vector;
                assert!(off.norm() < 1e-12, "arm {arm}, {frame:?}");
                assert!(pose(back).rotation.angle_to(&known.rotation) < 1e-7);
                let same = frame.by(&robot, &state, arm, [0.0; 6]);
                assert!((pose(same).translation.vector - known.translation.vector).norm() < 1e-12);
                // A shift along the first axis.
                let moved = pose(frame.by(&robot, &state, arm, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]));
                let axis = frame.placed(&robot, &state, arm).rotation * nalgebra::Vector3::x();
                let shift = moved.translation.vector - known.translation.vector;
                assert!((shift - 0.1 * axis).norm() < 1e-12);
                assert!(moved.rotation.angle_to(&known.rotation) < 1e-7);
            }
        }
    }
}
