//! Forward kinematics: where the hands are and how they move.

use super::kinematics::{point_velocity, poses, velocities};
use crate::model::Model;
use crate::scalar::{Kernel, Real};
use crate::spatial::{Mat3, Vec3, Vec6, add, mat_mat, mat_t_vec, mat_vec, quaternion_to_rotation};
use crate::state::State;
use crate::workspace::Workspace;

/// Pose and velocity of a hand (the tool frame of an arm).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand<S> {
    /// Origin in the world (m).
    pub position: Vec3<S>,
    /// Hand axes to world axes.
    pub rotation: Mat3<S>,
    /// Velocity of the origin, world axes (m/s).
    pub linear_velocity: Vec3<S>,
    /// Angular velocity, world axes (rad/s).
    pub angular_velocity: Vec3<S>,
}

impl<S: Real> Default for Hand<S> {
    fn default() -> Self {
        let zero = [S::zero(); 3];
        Self { position: zero, rotation: [zero; 3], linear_velocity: zero, angular_velocity: zero }
    }
}

/// Fills sines, link velocities and link poses of `ws` for `state`; returns the base's rotation.
#[inline(always)]
pub(crate) fn kinematics<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    state: &State<S>,
) -> Mat3<S> {
    let r_wb = quaternion_to_rotation(&state.base_quaternion);
    ws.base_v = Vec6 {
        ang: state.base_angular_velocity,
        lin: mat_t_vec(&r_wb, state.base_linear_velocity),
    };
    velocities(model, ws, &state.q, &state.qd);
    poses(model, ws);
    r_wb
}

/// Hands of all arms.
///
/// Shape: `out` `n_arms`.
///
/// # Panics
/// If `out` has another length.
#[inline(always)]
pub fn hands<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    state: &State<S>,
    out: &mut [Hand<S>],
) {
    assert!(out.len() == model.n_arms, "one hand an arm");
    S::compiled(Hands { model, ws, state, out });
}

/// The arguments of [`hands`].
struct Hands<'a, S: Real> {
    model: &'a Model<S>,
    ws: &'a mut Workspace<S>,
    state: &'a State<S>,
    out: &'a mut [Hand<S>],
}

impl<S: Real> Kernel<S> for Hands<'_, S> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Self { model, ws, state, out } = self;
        locate(model, ws, state, out);
    }
}

#[inline(always)]
fn locate<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, state: &State<S>, out: &mut [Hand<S>]) {
    let r_wb = kinematics(model, ws, state);
    for arm in 0..model.n_arms {
        let (at, last) = (&model.arms[arm], model.joints.of_arm(arm).end - 1);
        let (pose, v) = (ws.poses[last], ws.links[last].v);
        let r_wl = mat_mat(&r_wb, &pose.r);
        let p_b = add(pose.o, mat_vec(&pose.r, at.tool_position));
        out[arm] = Hand {
            position: add(state.base_position, mat_vec(&r_wb, p_b)),
            rotation: mat_mat(&r_wl, &at.tool_rotation),
            linear_velocity: mat_vec(&r_wl, point_velocity(v, at.tool_position)),
            angular_velocity: mat_vec(&r_wl, v.ang),
        };
    }
}
