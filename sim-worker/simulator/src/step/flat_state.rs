//! The state of the robot as one flat array, as integrators want it: displacement of the base since the period's start, quaternion,
//! velocities, q, q̇. The displacement is small, so single precision keeps three digits more than it would in the position.

use crate::dynamics::invariants::BaseMotion;
use crate::scalar::Real;
use crate::spatial::quaternion_normalised;
use crate::state::State;
use crate::workspace::Workspace;

pub(super) const QUATERNION: usize = 3;
pub(super) const LINEAR: usize = 7;
pub(super) const ANGULAR: usize = 10;
pub(super) const JOINTS: usize = 13;

/// Lays `state` out in `ws.y`.
#[inline(always)]
pub(super) fn lay_out<S: Real>(ws: &mut Workspace<S>, state: &State<S>) {
    let n = state.q.len();
    for i in 0..3 {
        ws.y[i] = S::zero();
        ws.y[LINEAR + i] = state.base_linear_velocity[i];
        ws.y[ANGULAR + i] = state.base_angular_velocity[i];
    }
    for i in 0..4 {
        ws.y[QUATERNION + i] = state.base_quaternion[i];
    }
    ws.y[JOINTS..JOINTS + n].copy_from_slice(&state.q);
    ws.y[JOINTS + n..].copy_from_slice(&state.qd);
}

/// Takes `ws.y` back into `state`.
#[inline(always)]
pub(super) fn take_back<S: Real>(ws: &Workspace<S>, state: &mut State<S>) {
    let n = state.q.len();
    for i in 0..3 {
        state.base_position[i] += ws.y[i];
        state.base_linear_velocity[i] = ws.y[LINEAR + i];
        state.base_angular_velocity[i] = ws.y[ANGULAR + i];
    }
    for i in 0..4 {
        state.base_quaternion[i] = ws.y[QUATERNION + i];
    }
    state.q.copy_from_slice(&ws.y[JOINTS..JOINTS + n]);
    state.qd.copy_from_slice(&ws.y[JOINTS + n..]);
}

/// The base's part of a flat state.
#[inline(always)]
pub(super) fn base_of<S: Real>(y: &[S]) -> BaseMotion<S> {
    BaseMotion {
        position: read3(y, 0),
        quaternion: read4(y, QUATERNION),
        linear: read3(y, LINEAR),
        angular: read3(y, ANGULAR),
    }
}

#[inline(always)]
pub(super) fn normalise<S: Real>(ws: &mut Workspace<S>) {
    let q = quaternion_normalised(&read4(&ws.y, QUATERNION));
    ws.y[QUATERNION..LINEAR].copy_from_slice(&q);
}

#[inline(always)]
pub(super) fn read3<S: Real>(y: &[S], at: usize) -> [S; 3] {
    [y[at], y[at + 1], y[at + 2]]
}

#[inline(always)]
pub(super) fn read4<S: Real>(y: &[S], at: usize) -> [S; 4] {
    [y[at], y[at + 1], y[at + 2], y[at + 3]]
}
