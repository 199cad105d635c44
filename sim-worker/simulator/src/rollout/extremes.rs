//! The best and the worst of an episode, for its metrics.

use crate::scalar::Real;
use crate::task::Errors;

/// Errors' minima and contacts so far.
pub(crate) struct Extremes<S> {
    pub(super) position: Vec<S>,
    pub(super) orientation: Vec<S>,
    pub(super) base: S,
    pub(super) contact_steps: S,
    pub(super) contact_pairs: S,
}

impl<S: Real> Extremes<S> {
    pub(super) fn new(n_arms: usize) -> Self {
        let far = S::splat(f64::INFINITY);
        Self {
            position: vec![far; n_arms],
            orientation: vec![far; n_arms],
            base: far,
            contact_steps: S::zero(),
            contact_pairs: S::zero(),
        }
    }

    #[inline(always)]
    pub(super) fn update(&mut self, errors: &Errors<S>, pairs: S) {
        for arm in 0..self.position.len() {
            self.position[arm] = errors.position_norm[arm].min(self.position[arm]);
            self.orientation[arm] = errors.orientation_norm[arm].min(self.orientation[arm]);
        }
        self.base = errors.base_norm.min(self.base);
        self.contact_steps += S::select(pairs.gt(S::zero()), S::one(), S::zero());
        self.contact_pairs += pairs;
    }
}
