//! Turning the base.

use nalgebra::{DMatrix, DVector, Vector3};

use super::least_squares::damped;
use super::momentum::BaseMotion;
use super::{GAIN, JacobianController, shorten};
use crate::inverse_kinematics::{base_pose, pose};
use crate::state::State;

/// How fast arms are drawn home (1/s), as far as the base does not turn by it: with less of it they swing into the base.
const HOME: f64 = 1.0;
/// Damping, in parts of the largest diagonal element.
const DAMPING: f64 = 1e-6;

impl JacobianController {
    /// Rates that turn the base towards `attitude` (Euler angles, rad) and leave it there.
    pub(super) fn turn(&self, now: &State<f64>, attitude: [f64; 3], moves: &[bool]) -> Vec<f64> {
        let mut rates = now.qd.clone();
        let Some(motion) = BaseMotion::of(&self.robot, now) else { return rates };
        let [a, b, c] = attitude;
        let goal = pose([0.0, 0.0, 0.0, a, b, c]).rotation;
        let base = base_pose(now).rotation;
        // In base axes, as the rows of the base's motion are.
        let left: Vector3<f64> = (base.inverse() * goal).scaled_axis();
        let joints = self.joints(moves);
        let mut carried: Vector3<f64> = motion.drift.fixed_rows::<3>(3).into();
        for joint in (0..rates.len()).filter(|&joint| !moves[self.robot.joints.arm_of(joint)]) {
            carried += motion.by_joints.fixed_view::<3, 1>(3, joint) * rates[joint];
        }
        let rows = joints.iter().flat_map(|&joint| {
            motion.by_joints.fixed_view::<3, 1>(3, joint).iter().copied().collect::<Vec<_>>()
        });
        let jacobian = DMatrix::from_iterator(3, joints.len(), rows);
        let wanted = GAIN / self.period * left - carried;
        let wanted = DVector::from_iterator(3, wanted.iter().copied());
        let home = self.robot.home_q();
        let preferred = joints.iter().map(|&joint| HOME * (home[joint] - now.q[joint]));
        let preferred = DVector::from_iterator(joints.len(), preferred);
        let damping = DAMPING * (&jacobian * jacobian.transpose()).diagonal().max();
        let found = damped(&jacobian, &wanted, &preferred, &DVector::repeat(3, damping));
        let mut found: Vec<f64> = found.iter().copied().collect();
        let limits: Vec<f64> = joints.iter().map(|joint| self.limits[*joint]).collect();
        shorten(&mut found, &limits);
        for (joint, rate) in joints.into_iter().zip(found) {
            rates[joint] = rate;
        }
        rates
    }
}
