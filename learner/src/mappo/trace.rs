//! What an update computed on its way.

use tch::Tensor;

/// What an update computed on its way; kept only on request, for tests.
#[derive(Debug, Default)]
pub struct MappoTrace {
    /// `[A, T, E]`: advantages, not standardised.
    pub advantage: Option<Tensor>,
    /// `[A, T, E]`: returns.
    pub returns: Option<Tensor>,
    /// `[A, T + 1, E]`: predictions in normalised units.
    pub value: Option<Tensor>,
    /// Unclipped gradients `[A, P]` of actors and critics, of every optimiser step.
    pub gradients: Vec<(Tensor, Tensor)>,
    /// Mean losses `[A]` of actors (surrogate) and critics, of every optimiser step.
    pub losses: Vec<(Vec<f64>, Vec<f64>)>,
    /// Rows of every mini-batch.
    pub rows: Vec<Vec<i64>>,
}
