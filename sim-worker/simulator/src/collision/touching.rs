//! What touches, told without pushing.

use super::find::{coarse_gap, place_bounds, proximity};
use crate::dynamics::{angle_contact_interval, kinematics_of};
use crate::model::{ContactKind, Model, Partner};
use crate::robot::MAX_ARMS;
use crate::scalar::{Kernel, Mask, Real};
use crate::state::State;
use crate::workspace::Workspace;

/// What touches, per lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touching<S> {
    /// Number of touching pairs of bodies, those told by joint angle included.
    pub pairs: S,
    /// The same by [`ContactKind`].
    pub by_kind: [S; ContactKind::COUNT],
    /// Those in which an arm takes part, by arm; two arms that touch count for both.
    pub by_arm: [S; MAX_ARMS],
    /// How deep the deepest pair of shapes overlaps (m); zero where none does.
    pub penetration: S,
}

/// Number of touching pairs of bodies, per lane.
#[inline(always)]
pub fn count_contacts<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, state: &State<S>) -> S {
    touching(model, ws, state).pairs
}

/// Number of touching pairs of bodies, and how deep they overlap, per lane.
#[inline(always)]
pub fn touching<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, state: &State<S>) -> Touching<S> {
    S::compiled(Look { model, ws, state })
}

/// The arguments of [`touching`].
struct Look<'a, S: Real> {
    model: &'a Model<S>,
    ws: &'a mut Workspace<S>,
    state: &'a State<S>,
}

impl<S: Real> Kernel<S> for Look<'_, S> {
    type Output = Touching<S>;
    #[inline(always)]
    fn run(self) -> Touching<S> {
        let Self { model, ws, state } = self;
        look(model, ws, state)
    }
}

#[inline(always)]
fn look<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, state: &State<S>) -> Touching<S> {
    kinematics_of(model, ws, state);
    let mut by_kind = [S::zero(); ContactKind::COUNT];
    let mut by_arm = [S::zero(); MAX_ARMS];
    for arm in 0..model.n_arms() {
        let first = model.joints.of_arm(arm).start;
        for contact in model.angle_contacts_of(arm) {
            let narrowing = &ws.links[first + contact.narrowing_joint];
            let q = state.q[first + contact.joint];
            let (x, half) = angle_contact_interval(contact, q, narrowing.sin, narrowing.cos);
            let touches = S::select(x.abs().le(half), S::one(), S::zero());
            by_kind[contact.kind as usize] += touches;
            by_arm[arm] += touches;
        }
    }
    place_bounds(model, ws);
    let mut penetration = S::zero();
    for pair in &model.collision.pairs {
        let near = coarse_gap(model, ws, pair).lt(S::zero());
        if !near.any() {
            continue;
        }
        let p = proximity(model, ws, pair, near, S::zero());
        let touches = near & p.gap.lt(S::zero());
        let one = S::select(touches, S::one(), S::zero());
        by_kind[pair.kind as usize] += one;
        let arm = model.joints.arm_of(pair.a);
        by_arm[arm] += one;
        if let Partner::Link(link) = pair.b
            && model.joints.arm_of(link) != arm
        {
            by_arm[model.joints.arm_of(link)] += one;
        }
        penetration = S::select(touches, (-p.gap).max(penetration), penetration);
    }
    // Small whole numbers: the sum is exact in any order.
    let [base, mount, own, arms] = by_kind;
    Touching { pairs: (base + mount) + (own + arms), by_kind, by_arm, penetration }
}
