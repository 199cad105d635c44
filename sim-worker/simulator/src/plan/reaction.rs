//! Arms that keep the base where it is while others move.
//!
//! Without forces from outside, momentum is what it was: H v + B q̇, with the robot's inertia H about the base, the base's velocity v, and B the
//! momentum of moving joints. Joint rates with B q̇ = −H v* give the base the velocity v* from rest (the reaction null space of [Nenchev, Umetani and
//! Yoshida 1992] for v* = 0). Here the rates of some arms are given, and those of the others follow by damped least squares.

use nalgebra::{DMatrix, DVector, Isometry3, Vector3};

use crate::dynamics::reference_dynamics::inertia_matrix;
use crate::inverse_kinematics::base_pose;
use crate::robot::Robot;
use crate::state::State;

/// Share of the base's way back that a second takes it (1/s).
const RETURN: f64 = 0.8;
/// Damping in parts of the largest diagonal element.
const DAMPING: f64 = 1e-4;

/// Replaces the `rates` (rad/s, arm-major) of the joints that are `free` so that the base returns to `home` and stays there.
pub(super) fn hold_base(
    robot: &Robot,
    state: &State<f64>,
    home: &Isometry3<f64>,
    free: &[bool],
    rates: &mut [f64],
) {
    let inertia = inertia_matrix(robot, state);
    let base = base_pose(state);
    let linear = home.translation.vector - base.translation.vector;
    // In base axes, as the columns of the inertia matrix are.
    let angular: Vector3<f64> = (base.rotation.inverse() * home.rotation).scaled_axis();
    let mut wanted = DVector::zeros(6);
    wanted.fixed_rows_mut::<3>(0).copy_from(&(RETURN * linear));
    wanted.fixed_rows_mut::<3>(3).copy_from(&(RETURN * angular));
    let mut momentum = inertia.view((0, 0), (6, 6)) * wanted;
    let joints: Vec<usize> = (0..rates.len()).filter(|&joint| free[joint]).collect();
    let mut of_free = DMatrix::zeros(6, joints.len());
    for (joint, rate) in rates.iter().enumerate().filter(|(joint, _)| !free[*joint]) {
        momentum += inertia.view((0, 6 + joint), (6, 1)) * *rate;
    }
    for (column, joint) in joints.iter().enumerate() {
        of_free.column_mut(column).copy_from(&inertia.view((0, 6 + joint), (6, 1)));
    }
    let mut square = &of_free * of_free.transpose();
    let damping = DAMPING * square.diagonal().max();
    for i in 0..6 {
        square[(i, i)] += damping;
    }
    let Some(factor) = square.cholesky() else { return };
    let answer = of_free.transpose() * factor.solve(&-momentum);
    for (joint, rate) in joints.iter().zip(answer.iter()) {
        rates[*joint] = *rate;
    }
}
