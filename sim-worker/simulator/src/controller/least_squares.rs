//! Damped least squares.

use nalgebra::{DMatrix, DVector};

/// The shortest joint rates beside `preferred` that come near to `wanted`: x = p + Jᵀ (J Jᵀ + Λ)⁻¹ (w − J p); `damping` is the
/// diagonal of Λ, λ² of every row.
pub(super) fn damped(
    jacobian: &DMatrix<f64>,
    wanted: &DVector<f64>,
    preferred: &DVector<f64>,
    damping: &DVector<f64>,
) -> DVector<f64> {
    let mut square = jacobian * jacobian.transpose();
    for i in 0..square.nrows() {
        square[(i, i)] += damping[i];
    }
    match square.cholesky() {
        Some(factor) => {
            preferred + jacobian.transpose() * factor.solve(&(wanted - jacobian * preferred))
        }
        // No number among them: whoever executes them says so.
        None => preferred.clone(),
    }
}
