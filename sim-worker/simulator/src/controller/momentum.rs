//! How the base moves when joints do.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use crate::dynamics::reference_dynamics::inertia_matrix;
use crate::robot::Robot;
use crate::state::State;

/// The base's velocity as a function of the joints' rates: v = `drift` + `by_joints` · q̇. Rows: linear (m/s, world axes), angular (rad/s, base axes).
pub(super) struct BaseMotion {
    /// Shape: `[6][J]`.
    pub(super) by_joints: DMatrix<f64>,
    /// What is left when all joints stand still: the momentum that pushes have given.
    pub(super) drift: SVector<f64, 6>,
}

impl BaseMotion {
    /// In a state of the robot.
    pub(super) fn of(robot: &Robot, state: &State<f64>) -> Option<Self> {
        let inertia = inertia_matrix(robot, state);
        let n = robot.n_joints();
        let own: SMatrix<f64, 6, 6> = inertia.fixed_view::<6, 6>(0, 0).into_owned();
        let factor = own.cholesky()?;
        let by_joints = -factor.solve(&inertia.view((0, 6), (6, n)).into_owned());
        let mut base = SVector::<f64, 6>::zeros();
        base.fixed_rows_mut::<3>(0).copy_from_slice(&state.base_linear_velocity);
        base.fixed_rows_mut::<3>(3).copy_from_slice(&state.base_angular_velocity);
        let rates = DVector::from_column_slice(&state.qd);
        let drift = base - SVector::<f64, 6>::from_iterator((&by_joints * rates).iter().copied());
        Some(Self { by_joints, drift })
    }
}
