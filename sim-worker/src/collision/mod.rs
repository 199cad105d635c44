//! Collisions (stub).
use crate::dynamics::Workspace;
use crate::robot::{Model, Robot};
use crate::scalar::Real;
use crate::spatial::Vec6;
use crate::state::State;

pub(crate) const STIFFNESS_RATE: f64 = 130.0 * 130.0;
pub(crate) const DAMPING_RATE: f64 = 2.0 * 0.7 * 130.0;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CollisionModel<S> { zero: S }
impl<S: Real> CollisionModel<S> { pub(crate) fn new(_: &Robot) -> Self { Self { zero: S::zero() } } }
#[derive(Clone, Debug)]
pub(crate) struct ContactSet<S> { zero: S }
impl<S: Real> ContactSet<S> { pub(crate) fn new(_: &Model<S>) -> Self { Self { zero: S::zero() } } }

/// Number of touching pairs, per lane.
#[inline(always)]
pub fn count_contacts<S: Real>(_model: &Model<S>, _ws: &mut Workspace<S>, _state: &State<S>) -> S { S::zero() }
#[inline(always)]
pub(crate) fn clear<S: Real>(ws: &mut Workspace<S>) {
    ws.base_f_ext = Vec6::zero();
    for link in &mut ws.links { link.f_ext = Vec6::zero(); }
}
#[inline(always)]
pub(crate) fn broad_phase<S: Real>(_: &Model<S>, _: &mut Workspace<S>, _: f64) {}
#[inline(always)]
pub(crate) fn any_near<S: Real>(_: &Workspace<S>) -> bool { false }
#[inline(always)]
pub(crate) fn narrow_phase<S: Real>(_: &Model<S>, _: &mut Workspace<S>) {}
#[inline(always)]
pub(crate) fn articulated_inertias<S: Real>(_: &Model<S>, _: &mut Workspace<S>) {}
#[inline(always)]
pub(crate) fn push<S: Real>(_: &Model<S>, _: &mut Workspace<S>) {}
