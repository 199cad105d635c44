//! How far bodies are from touching.

use super::find::{coarse_gap, place_bounds, proximity};
use crate::dynamics::kinematics_of;
use crate::model::Model;
use crate::scalar::{Kernel, Mask, Real};
use crate::state::State;
use crate::workspace::Workspace;

/// Smallest distance between two bodies that may touch, per lane (m); negative where they overlap. Pairs that touch by joint angle have none.
#[inline(always)]
pub fn clearance<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, state: &State<S>) -> S {
    S::compiled(Look { model, ws, state })
}

/// The arguments of [`clearance`].
struct Look<'a, S: Real> {
    model: &'a Model<S>,
    ws: &'a mut Workspace<S>,
    state: &'a State<S>,
}

impl<S: Real> Kernel<S> for Look<'_, S> {
    type Output = S;
    #[inline(always)]
    fn run(self) -> S {
        let Self { model, ws, state } = self;
        kinematics_of(model, ws, state);
        place_bounds(model, ws);
        let mut least = S::splat(f64::INFINITY);
        for pair in &model.collision.pairs {
            let near = coarse_gap(model, ws, pair).lt(least);
            if near.any() {
                let gap = proximity(model, ws, pair, near, least).gap;
                least = S::select(near, gap.min(least), least);
            }
        }
        least
    }
}
