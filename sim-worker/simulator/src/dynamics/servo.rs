//! Joint torques: the velocity servo, and the contacts that a joint's angle tells.

use crate::model::{AngleContactModel, Model};
use crate::scalar::Real;
use crate::workspace::Workspace;

/// The velocity servo's torques into `tau` of `ws.links`: clamp(k (clamp(c, ±c_max) − q̇), ±τ_max).
///
/// Shapes: `command` (rad/s), `qd` `n_joints`.
#[inline(always)]
pub(crate) fn servo<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, command: &[S], qd: &[S]) {
    for arm in 0..model.n_arms {
        for (link, i) in model.links_of(arm).iter().zip(model.joints.of_arm(arm)) {
            let c = command[i].clamp(-link.max_rate, link.max_rate);
            let tau = link.gain * (c - qd[i]);
            ws.links[i].tau = tau.clamp(-link.max_torque, link.max_torque);
        }
    }
}

/// Offset of an angle from the middle of the interval in which a pair touches, wrapped to ±π, and half of the interval.
#[inline(always)]
pub(crate) fn angle_contact_interval<S: Real>(
    contact: &AngleContactModel<S>,
    q: S,
    sin: S,
    cos: S,
) -> (S, S) {
    let x = q - contact.centre;
    let turns = (x * S::splat(0.5 / std::f64::consts::PI)).round();
    // |sin 2q| = 2 |sin q cos q|.
    let two_sin_cos = (sin + sin) * cos;
    let half = contact.narrowing.neg_mul_add(two_sin_cos.abs(), contact.half);
    (turns.neg_mul_add(S::splat(std::f64::consts::TAU), x), half)
}

/// Adds the torques of the pushing contacts by angle to `tau` of `ws.links`, which holds `sin` and `cos`.
///
/// Such a contact is a predictive spring and damper as others are (see [`crate::collision`]), on the angle and with the armature as mass:
/// no less than that moves when the joint does.
#[inline(always)]
pub(crate) fn push_of_angle_contacts<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    q: &[S],
    qd: &[S],
) {
    let (stiffness, damping) = ws.contacts.rates();
    for arm in 0..model.n_arms {
        let first = model.joints.of_arm(arm).start;
        for contact in model.angle_contacts_of(arm).iter().filter(|contact| contact.push) {
            let armature = model.links_of(arm)[contact.joint].armature;
            let i = first + contact.joint;
            let narrowing = &ws.links[first + contact.narrowing_joint];
            let (x, half) = angle_contact_interval(contact, q[i], narrowing.sin, narrowing.cos);
            let gap = x.abs() - half;
            let outward = x.copy_sign_to(S::one());
            let closing = damping * (outward * qd[i]);
            let push = stiffness.mul_add(gap, closing);
            let push = (-armature * push).max(S::zero());
            ws.links[i].tau = outward.mul_add(push, ws.links[i].tau);
        }
    }
}
