//! The frame in which an arm sees the world, so that what one arm learns fits all.
//!
//! Arms are one arm on several faces of the base. An **arm frame** is fixed in the base; its third axis
//! is the outward normal of the arm's mount, its first the mount's x, or against it if the arm's first
//! joint is at home turned by more than a quarter. Seen from their arm frames the arms of the paper's
//! robot are at home in the same pose, and move alike.
//!
//! **Why frames that move with the base.** Without gravity neither where the base is nor how it is turned matters
//! to what a hand must do or to how an arm moves. A policy that does not know them acts alike wherever the base
//! has been brought: by other arms with another policy, by a push, by a fault. Policies that saw the world's axes
//! were lost when others turned the base by 0.2 rad. What it costs: the base's position also told, by the centre
//! of mass, where the other arms are.

use super::HomeArm;
use crate::scalar::Real;

/// Rotation of the base's axes to an arm frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct ArmFrame {
    /// Axes in the base's, `[axis][component]`.
    axes: [[f64; 3]; 3],
}

impl ArmFrame {
    /// The frame of `arm`.
    pub(super) fn new(arm: &HomeArm) -> Self {
        let side = 1.0_f64.copysign(libm::cos(arm.q[0]));
        let [x, y, z] = arm.mount;
        // At home the base's axes are the world's.
        Self { axes: [x.map(|c| side * c), y.map(|c| side * c), z] }
    }

    /// The axes in the base's, `[axis][component]`.
    pub(super) fn axes(&self) -> [[f64; 3]; 3] {
        self.axes
    }

    /// A vector in the base's axes.
    #[inline(always)]
    pub(super) fn vector<S: Real>(&self, v: [S; 3]) -> [S; 3] {
        let [x, y, z] = self.axes;
        [along(x, v), along(y, v), along(z, v)]
    }
}

/// How far `v` reaches along an axis.
#[inline(always)]
fn along<S: Real>(axis: [f64; 3], v: [S; 3]) -> S {
    let [x, y, z] = axis;
    S::splat(x).mul_add(v[0], S::splat(y).mul_add(v[1], S::splat(z) * v[2]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{Physics, home};
    use crate::robot::Robot;
    use crate::spatial::{euler_xyz_to_rotation, rotation_difference};
    use crate::state::State;
    use crate::step::StepOptions;
    use crate::task::Readings;

    /// The paper's home angles are 3.14 where π would be alike to the bit, so a hand a metre away is 1.6 mm off.
    #[test]
    fn arms_in_the_same_pose_look_the_same_from_their_frames() {
        let robot = Robot::builtin("paper").expect("built in");
        let mut state = State::<f64>::home(&robot);
        for q in state.q.chunks_exact_mut(6) {
            for (angle, offset) in q.iter_mut().zip([0.3, -0.4, 0.5, 0.2, -0.3, 0.4]) {
                *angle += offset;
            }
        }
        let mut readings = Readings::new(&robot.joints);
        Physics::with_options(&robot, StepOptions::default()).read(&state, &mut readings);
        let home = home(&robot);
        let moved = home.arms.iter().zip(&readings.hands).map(|(arm, hand)| {
            let frame = ArmFrame::new(arm);
            let difference = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] - b[i]);
            let position = frame.vector(difference(hand.position, arm.position));
            let [was, is] = [arm.euler, hand.euler].map(euler_xyz_to_rotation);
            [position, frame.vector(rotation_difference(&is, &was))].concat()
        });
        let moved: Vec<Vec<f64>> = moved.collect();
        assert!(moved[0].iter().all(|x| x.abs() > 0.01), "nothing to compare: {:?}", moved[0]);
        for other in &moved[1..] {
            for (x, y) in moved[0].iter().zip(other) {
                assert!((x - y).abs() < 4e-3, "{:?} and {other:?}", moved[0]);
            }
        }
    }

    #[test]
    fn a_turned_arm_sees_vectors_from_the_other_side() {
        let arm = HomeArm {
            q: vec![3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            command_limit: vec![1.0; 6],
            position: [0.0; 3],
            euler: [0.0; 3],
            mount: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        };
        let frame = ArmFrame::new(&arm);
        assert_eq!(frame.vector([1.0, 2.0, 3.0]), [-1.0, 3.0, 2.0]);
    }
}
