//! The equations of motion: the derivative of a flat state.

use super::disturbance::{Disturbance, disturb_bodies, disturb_joints};
use super::flat_state::{ANGULAR, JOINTS, LINEAR, QUATERNION, read3, read4};
use crate::collision;
use crate::dynamics::aba::{aba, world_acceleration};
use crate::dynamics::kinematics::{poses, poses_of_arm, velocities};
use crate::dynamics::servo::{push_of_angle_contacts, servo};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{Vec6, mat_t_vec, quaternion_product, quaternion_to_rotation};
use crate::workspace::Workspace;

/// What an evaluation does about contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Contacts {
    /// Nothing.
    Off,
    /// Finds contacts and pushes at them: at the start of a substep of length `h`, `now` after the period's (s).
    Find { now: f64, h: f64 },
    /// Pushes at the contacts found.
    Push,
}

/// The derivative of `ws.y` into `ws.k`.
#[inline(always)]
pub(super) fn derivative<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    command: &[S],
    contacts: Contacts,
    disturbance: Option<&Disturbance<S>>,
) {
    let n = model.n_joints();
    let quaternion = read4(&ws.y, QUATERNION);
    let linear = read3(&ws.y, LINEAR);
    let angular = read3(&ws.y, ANGULAR);
    let r_wb = quaternion_to_rotation(&quaternion);
    ws.base_v = Vec6 { ang: angular, lin: mat_t_vec(&r_wb, linear) };

    // The flat arrays leave the workspace while it is lent.
    let y = std::mem::take(&mut ws.y);
    let mut k = std::mem::take(&mut ws.k);
    let (q, qd) = y[JOINTS..].split_at(n);
    velocities(model, ws, q, qd);
    servo(model, ws, command, qd);
    if let Some(disturbance) = disturbance {
        disturb_joints(ws, disturbance);
    }
    contact_forces(model, ws, q, qd, contacts, disturbance.is_some());
    if let Some(disturbance) = disturbance {
        disturb_bodies(model, ws, disturbance, &r_wb, read3(&y, 0));
    }
    let (k_q, k_qd) = k[JOINTS..].split_at_mut(n);
    k_q.copy_from_slice(qd);
    let a = aba(model, ws, qd, k_qd);
    let a_w = world_acceleration(ws.base_v, a, &r_wb);
    let half = S::splat(0.5);
    let [w0, w1, w2] = angular;
    let rate = quaternion_product(&quaternion, &[S::zero(), half * w0, half * w1, half * w2]);
    k[..3].copy_from_slice(&linear);
    k[QUATERNION..LINEAR].copy_from_slice(&rate);
    k[LINEAR..ANGULAR].copy_from_slice(&a_w);
    k[ANGULAR..JOINTS].copy_from_slice(&a.ang);
    ws.y = y;
    ws.k = k;
}

/// Contacts' forces on base and links, in place of all that were there, and the torques of those that joints' angles tell.
///
/// Reads `sin`, `cos` and `v` of the links; fills `poses` where contacts need them.
#[inline(always)]
fn contact_forces<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    q: &[S],
    qd: &[S],
    contacts: Contacts,
    disturbed: bool,
) {
    if contacts == Contacts::Off {
        ws.take_off_outside_forces();
        return;
    }
    push_of_angle_contacts(model, ws, q, qd);
    if let Contacts::Find { now, h } = contacts {
        poses(model, ws);
        if disturbed {
            ws.contacts.wake_all();
        }
        collision::find(model, ws, now, h);
    } else {
        for arm in 0..model.n_arms {
            if ws.contacts.touches_arm(arm) {
                poses_of_arm(model, ws, arm);
            }
        }
    }
    if ws.contacts.any() {
        collision::push(model, ws);
    } else {
        ws.take_off_outside_forces();
    }
}
