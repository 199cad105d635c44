//! Forward dynamics: the articulated-body algorithm [Featherstone 2008, Table 7.1, with the floating base of Table 9.4].
//!
//! In link frames, one function a pass. Rows of the table stand beside the lines that compute them, i a link, λ the one before it:
//!
//! * first pass, [`velocities`], from the base to the hands: v_i;
//! * second pass, [`inertias_and_bias_forces`], from the hands to the base: I_A and p_A. What the table has in its first pass but only its second
//!   needs (c_i, I_i, v_i ×* I_i v_i − f_i) is computed here, where it is used;
//! * third pass, [`accelerations`], from the base to the hands: a_i and q̈_i.
//!
//! With the armature J of the drives, D = Sᵀ U + J; it takes part in no force between links. S is the unit turn about z, c_J is zero, there is no gravity.

use super::articulated::{ArticulatedInertia, PlanarMotion};
use super::kinematics::{
    for_sparsity, force_from_next, force_to_base, motion_to_arm, motion_to_next, turn, unturn,
    velocities,
};
use crate::model::{LinkModel, Model, RigidInertia};
use crate::scalar::Real;
use crate::spatial::{
    Vec6, add, cross, cross_add, mat_t_vec, mat_vec, quaternion_to_rotation, scale,
};
use crate::state::State;
use crate::workspace::{LinkScratch, Workspace};

/// Derivative of the generalised velocity.
#[derive(Clone, Debug, PartialEq)]
pub struct Acceleration<S> {
    /// Of the base frame's origin, world axes (m/s²).
    pub base_linear: [S; 3],
    /// Of the base, base axes (rad/s²).
    pub base_angular: [S; 3],
    /// Of the joints (rad/s²), arm-major.
    pub joints: Vec<S>,
}

/// Acceleration of the robot under joint torques `tau` (N m, arm-major, `n_joints`), without contacts.
pub fn forward_dynamics<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    state: &State<S>,
    tau: &[S],
) -> Acceleration<S> {
    assert_eq!(tau.len(), model.n_joints(), "torques");
    let r_wb = quaternion_to_rotation(&state.base_quaternion);
    ws.base_v = Vec6 {
        ang: state.base_angular_velocity,
        lin: mat_t_vec(&r_wb, state.base_linear_velocity),
    };
    velocities(model, ws, &state.q, &state.qd);
    for (link, &t) in ws.links.iter_mut().zip(tau) {
        link.tau = t;
    }
    ws.forced.fill(false);
    ws.base_f_ext = Vec6::zero();
    let mut joints = vec![S::zero(); model.n_joints()];
    let a = aba(model, ws, &state.qd, &mut joints);
    Acceleration {
        base_linear: world_acceleration(ws.base_v, a, &r_wb),
        base_angular: a.ang,
        joints,
    }
}

/// Acceleration of the base's origin in world axes: R (v̇ + ω × v), because v is given in axes that turn.
#[inline(always)]
pub(crate) fn world_acceleration<S: Real>(
    v: Vec6<S>,
    a: Vec6<S>,
    r_wb: &crate::spatial::Mat3<S>,
) -> [S; 3] {
    mat_vec(r_wb, cross_add(v.ang, v.lin, a.lin))
}

/// Spatial acceleration of the base (base axes) and joint accelerations `qdd`.
///
/// Reads `ws.base_v`, `ws.base_f_ext` and of every link `sin`, `cos`, `v`, `tau` and, where it is `forced`, `f_ext`; fills `u_col`, `d_inv`, `u`.
#[inline(always)]
pub(crate) fn aba<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    qd: &[S],
    qdd: &mut [S],
) -> Vec6<S> {
    let (inertia, p) = inertias_and_bias_forces(model, ws, qd);
    // a_0 = −(I_0_A)⁻¹ p_0_A (Table 9.4).
    let minus = S::splat(-1.0);
    let a = inertia.solve(Vec6 { ang: scale(minus, p.ang), lin: scale(minus, p.lin) });
    accelerations(model, ws, a, qd, qdd);
    a
}

/// Second pass, from the hands to the base: the base's articulated inertia I_0_A and bias force p_0_A.
///
/// Reads and fills `ws` as [`aba`] does.
#[inline(always)]
fn inertias_and_bias_forces<S: Real>(
    model: &Model<S>,
    ws: &mut Workspace<S>,
    qd: &[S],
) -> (ArticulatedInertia<S>, Vec6<S>) {
    // I_0_A = I_0, p_0_A = v_0 ×* I_0 v_0 − f_0.
    let mut inertia0 = ArticulatedInertia::zero();
    inertia0.add_body(&model.base);
    let mut p0 = bias_force(&model.base, ws.base_v);
    p0.ang = sub3(p0.ang, ws.base_f_ext.ang);
    p0.lin = sub3(p0.lin, ws.base_f_ext.lin);
    for arm in 0..model.n_arms {
        let (links, first) = (model.links_of(arm), model.joints.of_arm(arm).start);
        let mut inertia = ArticulatedInertia::zero();
        let mut p = Vec6::zero();
        let mut j = links.len();
        while j > 0 {
            j -= 1;
            let (body, i) = (&links[j], first + j);
            let (link, forced, rate) = (&mut ws.links[i], ws.forced[i], qd[i]);
            // One straight piece of code for each shape: between pieces, the 27 numbers that are carried along would go through memory.
            (inertia, p) = if j + 1 == links.len() {
                through_joint(body, link, forced, rate, inertia, p)
            } else {
                // The step between two link frames of λX_i* I_a iX_λ and λX_i* p_a; `through_joint` has made the turn.
                for_sparsity!(body.sparsity, sparsity => {
                    let inertia = inertia.moved_to_previous(body, sparsity);
                    let p = force_from_next(body, sparsity, p);
                    through_joint(body, link, forced, rate, inertia, p)
                })
            };
        }
        // I_0_A += 0X_i* I_a iX_0, p_0_A += 0X_i* p_a.
        inertia0.add(&inertia.moved_to_base(&model.arms[arm]));
        let f = force_to_base(&model.arms[arm], p);
        p0.ang = add(p0.ang, f.ang);
        p0.lin = add(p0.lin, f.lin);
    }
    (inertia0, p0)
}

/// Third pass, from the base to the hands: the joint accelerations `qdd` for the base's, `a0`.
#[inline(always)]
fn accelerations<S: Real>(
    model: &Model<S>,
    ws: &Workspace<S>,
    a0: Vec6<S>,
    qd: &[S],
    qdd: &mut [S],
) {
    for arm in 0..model.n_arms {
        let (links, first) = (model.links_of(arm), model.joints.of_arm(arm).start);
        let mut a = motion_to_arm(&model.arms[arm], a0);
        for j in 0..links.len() {
            // a′ = iX_λ a_λ + c_i.
            if j > 0 {
                let before = &links[j - 1];
                a = for_sparsity!(before.sparsity, sparsity => motion_to_next(before, sparsity, a));
            }
            let link = &ws.links[first + j];
            a.ang = unturn(link.sin, link.cos, a.ang);
            a.lin = unturn(link.sin, link.cos, a.lin);
            let c = velocity_product(link.v, qd[first + j]);
            a.ang[0] += c.ang[0];
            a.ang[1] += c.ang[1];
            a.lin[0] += c.lin[0];
            a.lin[1] += c.lin[1];
            // q̈_i = D⁻¹ (u_i − U_iᵀ a′).
            let (n, f) = (link.u_col.ang, link.u_col.lin);
            let mut rest = link.u;
            for i in 0..3 {
                rest = n[i].neg_mul_add(a.ang[i], rest);
                rest = f[i].neg_mul_add(a.lin[i], rest);
            }
            let acceleration = rest * link.d_inv;
            qdd[first + j] = acceleration;
            // a_i = a′ + S q̈_i.
            a.ang[2] += acceleration;
        }
    }
}

/// A link of the second pass: adds it to the articulated inertia and bias force of what it carries, both in its frame, and takes the sum through its
/// joint: before the joint's turn, as the link before carries it.
#[inline(always)]
fn through_joint<S: Real>(
    body: &LinkModel<S>,
    link: &mut LinkScratch<S>,
    forced: bool,
    rate: S,
    mut inertia: ArticulatedInertia<S>,
    mut p: Vec6<S>,
) -> (ArticulatedInertia<S>, Vec6<S>) {
    // I_i_A += I_i.
    inertia.add_body(&body.body);
    // p_i_A += v_i ×* I_i v_i − f_i.
    let mut own = bias_force(&body.body, link.v);
    if forced {
        own.ang = sub3(own.ang, link.f_ext.ang);
        own.lin = sub3(own.lin, link.f_ext.lin);
    }
    p.ang = add(p.ang, own.ang);
    p.lin = add(p.lin, own.lin);

    // U = I_A S.
    let u_col = inertia.z_column();
    // D = Sᵀ U + J.
    let d_inv = (u_col.ang[2] + body.armature).recip();
    // u = τ − Sᵀ p_A.
    let u = link.tau - p.ang[2];
    link.u_col = u_col;
    link.d_inv = d_inv;
    link.u = u;
    // I_a = I_A − U D⁻¹ Uᵀ.
    inertia.remove(u_col, d_inv);
    // p_a = p_A + I_a c + U D⁻¹ u.
    p = inertia.apply_planar(velocity_product(link.v, rate), p);
    let ud = u * d_inv;
    p.ang = crate::spatial::mul_add(ud, u_col.ang, p.ang);
    p.lin = crate::spatial::mul_add(ud, u_col.lin, p.lin);
    // The turn of λX_i*.
    p.ang = turn(link.sin, link.cos, p.ang);
    p.lin = turn(link.sin, link.cos, p.lin);
    (inertia.turned(link.sin, link.cos), p)
}

#[inline(always)]
fn sub3<S: Real>(a: [S; 3], b: [S; 3]) -> [S; 3] {
    crate::spatial::sub(a, b)
}

/// c = v × S q̇ for a joint about z: (ω × z q̇, v × z q̇).
#[inline(always)]
fn velocity_product<S: Real>(v: Vec6<S>, qd: S) -> PlanarMotion<S> {
    PlanarMotion { ang: [v.ang[1] * qd, -(v.ang[0] * qd)], lin: [v.lin[1] * qd, -(v.lin[0] * qd)] }
}

/// v ×* I v of a rigid body.
///
/// With h the mass times centre of mass: moment ω × (I ω) + h × (ω × v), force m ω × v + ω × (ω × h); the moment's form follows
/// from Jacobi's identity and saves a product.
#[inline(always)]
fn bias_force<S: Real>(body: &RigidInertia<S>, v: Vec6<S>) -> Vec6<S> {
    let [xx, yy, zz, xy, xz, yz] = body.inertia;
    let w = v.ang;
    let momentum = mat_vec(&[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], w);
    let wv = cross(w, v.lin);
    let wh = cross(w, body.h);
    Vec6 {
        ang: cross_add(w, momentum, cross(body.h, wv)),
        lin: cross_add(w, wh, scale(body.mass, wv)),
    }
}
