//! The forces of contacts: what each holds against, how they feel each other, and where they push.
//!
//! **Why predictive, and together.** A force begins when the gap would close within the damper's reach, with the
//! mass that the joints show at the contact and against most of what torques press with. So every gap is an
//! oscillator of one frequency, as stiff as the substep allows. Forces that work on the same joints come from a
//! few projected Gauss–Seidel sweeps. Sharing the stiffness among them instead let arms sink in two to four times
//! as deep at a step of 20 ms.

use crate::dynamics::kinematics::{
    for_sparsity, force_from_next, point_in_link, point_velocity, turn,
};
use crate::model::{Model, Pair, Partner};
use crate::robot::MAX_JOINTS_PER_ARM;
use crate::scalar::{Mask, Real};
use crate::spatial::{Vec3, Vec6, add, cross, cross_add, dot, mat_t_vec, mat_vec, scale, sub};
use crate::workspace::{Contact, ContactSet, Response, Workspace};

/// Share of the acceleration that torques give a gap against which a contact holds before it is indented. Not all: the masses that joints show leave out
/// what the base gives way, and a contact that held more than there is would hover.
const HELD: f64 = 0.9;

/// Sweeps over the contacts of a lane group in which their forces settle.
const SWEEPS: usize = 4;

/// Contacts never count as heavier than this (kg): near a joint's axis the joint shows a mass without bound.
const HEAVIEST: f64 = 50.0;

/// Leaves in `free` of the contact set what the last evaluation's torques were at each joint less what its contacts pushed: u of the second pass of the
/// articulated-body algorithm.
#[inline(always)]
pub(super) fn take_off_forces<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for i in 0..ws.links.len() {
        ws.contacts.free[i] = ws.links[i].u;
    }
    for i in 0..ws.contacts.contacts.len() {
        let contact = ws.contacts.contacts[i];
        for (arm, response) in arms(model, &model.collision.pairs[contact.pair], &contact) {
            let Some(arm) = arm else { continue };
            for (&r, i) in response.iter().zip(model.joints.of_arm(arm)) {
                let u = &mut ws.contacts.free[i];
                *u = r.neg_mul_add(contact.force, *u);
            }
        }
    }
}

/// How much a contact holds against beforehand (m/s²): Σ u r / D is what the gap would accelerate with, the base held.
#[inline(always)]
pub(super) fn hold<S: Real>(model: &Model<S>, ws: &Workspace<S>, contact: &Contact<S>) -> S {
    let mut free = S::zero();
    for (arm, response) in arms(model, &model.collision.pairs[contact.pair], contact) {
        let Some(arm) = arm else { continue };
        for (&r, i) in response.iter().zip(model.joints.of_arm(arm)) {
            free = (r * ws.links[i].d_inv).mul_add(ws.contacts.free[i], free);
        }
    }
    let held = (S::splat(-HELD) * free).max(S::zero());
    S::select(contact.lanes, held, S::zero())
}

/// Notes W = J M⁻¹ Jᵀ along the normals: the inverse of the mass that each contact shows, and what it feels of the others.
#[inline(always)]
pub(super) fn couple<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    ws.contacts.couplings.clear();
    for i in 0..ws.contacts.contacts.len() {
        let contact = ws.contacts.contacts[i];
        let own = coupling(model, ws, &contact, &contact) + S::splat(1.0 / HEAVIEST);
        ws.contacts.contacts[i].mass = own.recip();
        ws.contacts.contacts[i].others = ws.contacts.couplings.len();
        for j in 0..ws.contacts.contacts.len() {
            let other = &ws.contacts.contacts[j];
            let both = contact.lanes & other.lanes;
            if j != i && both.any() {
                let w = coupling(model, ws, &contact, other);
                // A lane that is not near may hold anything in its normal.
                let w = S::select(both, w, S::zero());
                ws.contacts.couplings.push((j, w));
            }
        }
    }
}

/// The forces that make every gap an oscillator, all contacts together: W F ≥ drive, F ≥ 0, one of them tight, by projected Gauss–Seidel sweeps
/// [Cottle, Pang and Stone 1992, The Linear Complementarity Problem, ch. 5].
#[inline(always)]
fn solve<S: Real>(set: &mut ContactSet<S>) {
    for sweep in 0..SWEEPS {
        for i in 0..set.contacts.len() {
            let contact = set.contacts[i];
            let end = set.contacts.get(i + 1).map_or(set.couplings.len(), |next| next.others);
            let mut rest = contact.drive;
            for &(j, w) in &set.couplings[contact.others..end] {
                if sweep > 0 || j < i {
                    rest = w.neg_mul_add(set.contacts[j].force, rest);
                }
            }
            let force = (contact.mass * rest).max(S::zero());
            set.contacts[i].force = S::select(contact.lanes, force, S::zero());
        }
    }
}

/// Element of W = J M⁻¹ Jᵀ: Σ uᵢ uⱼ / D over the joints of the arms both contacts push at, with the base held.
#[inline(always)]
fn coupling<S: Real>(
    model: &Model<S>,
    ws: &Workspace<S>,
    one: &Contact<S>,
    other: &Contact<S>,
) -> S {
    let (one_pair, other_pair) =
        (&model.collision.pairs[one.pair], &model.collision.pairs[other.pair]);
    let mut sum = S::zero();
    for (one_arm, u) in arms(model, one_pair, one) {
        for (other_arm, v) in arms(model, other_pair, other) {
            if let Some(arm) = one_arm
                && one_arm == other_arm
            {
                for ((&u, &v), i) in u.iter().zip(v).zip(model.joints.of_arm(arm)) {
                    sum = (u * ws.links[i].d_inv).mul_add(v, sum);
                }
            }
        }
    }
    sum
}

/// The arms a contact pushes at, with its response there.
#[inline(always)]
pub(super) fn arms<'a, S: Real>(
    model: &Model<S>,
    pair: &Pair<S>,
    contact: &'a Contact<S>,
) -> [(Option<usize>, &'a Response<S>); 2] {
    let a = model.joints.arm_of(pair.a);
    let b = match pair.b {
        Partner::Link(b) => Some(model.joints.arm_of(b)).filter(|&b| b != a),
        Partner::Fixed(_) => None,
    };
    [(Some(a), &contact.at_a), (b, &contact.at_b)]
}

/// What the unit wrench (base frame, at its origin) on a link leaves at the joints of its arm, link by link up to the base.
///
/// u of the second pass of the articulated-body algorithm for that force alone: with D from there, Σ u²/D is what the link gives way, with
/// the base held. Contacts move bodies of one and the same robot against each other, so what the base gives way is small.
#[inline(always)]
pub(super) fn arm_response<S: Real>(
    model: &Model<S>,
    ws: &Workspace<S>,
    link: usize,
    unit: Vec6<S>,
) -> Response<S> {
    let pose = &ws.poses[link];
    let lin = mat_t_vec(&pose.r, unit.lin);
    // Moment about the link frame's origin.
    let ang = mat_t_vec(&pose.r, sub(unit.ang, cross(pose.o, unit.lin)));
    let mut f = Vec6 { ang, lin };
    let mut response = [S::zero(); MAX_JOINTS_PER_ARM];
    let arm = model.joints.arm_of(link);
    let (links, first) = (model.links_of(arm), model.joints.of_arm(arm).start);
    let mut i = link;
    loop {
        let scratch = &ws.links[i];
        let u = f.ang[2];
        response[i - first] = u;
        if i == first {
            return response;
        }
        let ud = u * scratch.d_inv;
        f.ang = crate::spatial::mul_add(-ud, scratch.u_col.ang, f.ang);
        f.lin = crate::spatial::mul_add(-ud, scratch.u_col.lin, f.lin);
        f.ang = turn(scratch.sin, scratch.cos, f.ang);
        f.lin = turn(scratch.sin, scratch.cos, f.lin);
        i -= 1;
        let body = &links[i - first];
        f = for_sparsity!(body.sparsity, sparsity => force_from_next(body, sparsity, f));
    }
}

/// Hold − ω² g − 2 ζ ω v: what pushes where it is positive (m/s²).
#[inline(always)]
pub(super) fn drive<S: Real>(set: &ContactSet<S>, contact: &Contact<S>, gap: S, rate: S) -> S {
    set.stiffness.neg_mul_add(gap, set.damping.neg_mul_add(rate, contact.hold))
}

/// Gap of a contact, its rate, and A's point in the base frame.
#[inline(always)]
pub(super) fn gap_and_rate<S: Real>(
    model: &Model<S>,
    ws: &Workspace<S>,
    contact: &Contact<S>,
) -> (S, S, Vec3<S>) {
    let bodies = &model.collision.pairs[contact.pair];
    let a = &ws.poses[bodies.a];
    let p_a = add(mat_vec(&a.r, contact.on_a), a.o);
    let v_a = mat_vec(&a.r, point_velocity(ws.links[bodies.a].v, contact.on_a));
    let (p_b, v_b) = match bodies.b {
        Partner::Link(i) => {
            let b = &ws.poses[i];
            (
                add(mat_vec(&b.r, contact.on_b), b.o),
                mat_vec(&b.r, point_velocity(ws.links[i].v, contact.on_b)),
            )
        }
        Partner::Fixed(_) => (contact.on_b, point_velocity(ws.base_v, contact.on_b)),
    };
    (dot(contact.normal, sub(p_a, p_b)), dot(contact.normal, sub(v_a, v_b)), p_a)
}

/// Puts the contacts' forces on base and links. Reads `poses` and `v` of the links.
///
/// Force and counterforce act along one line through A's point, so total momentum stays. Sums start at +0 and lanes without contact
/// add ±0 to them, which changes no bit.
#[inline(always)]
pub(crate) fn push<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    ws.take_off_outside_forces();
    for i in 0..ws.contacts.contacts.len() {
        let contact = ws.contacts.contacts[i];
        let (gap, rate, point) = gap_and_rate(model, ws, &contact);
        ws.contacts.contacts[i].drive = drive(&ws.contacts, &contact, gap, rate);
        ws.contacts.contacts[i].point = point;
    }
    solve(&mut ws.contacts);
    for i in 0..ws.contacts.contacts.len() {
        let contact = ws.contacts.contacts[i];
        let bodies = &model.collision.pairs[contact.pair];
        let point = contact.point;
        let mut force = scale(contact.force, contact.normal);
        for x in &mut force {
            // A lane that is not near may hold anything in its normal.
            *x = S::select(contact.lanes, *x, S::zero());
        }
        push_link(ws, bodies.a, point, force);
        let back = [-force[0], -force[1], -force[2]];
        match bodies.b {
            Partner::Link(b) => push_link(ws, b, point, back),
            Partner::Fixed(_) => {
                let f = &mut ws.base_f_ext;
                f.ang = cross_add(point, back, f.ang);
                f.lin = add(f.lin, back);
            }
        }
    }
}

/// Adds a force (base axes) at a point (base frame) to a link.
#[inline(always)]
pub(crate) fn push_link<S: Real>(
    ws: &mut Workspace<S>,
    link: usize,
    point: Vec3<S>,
    force: Vec3<S>,
) {
    let pose = &ws.poses[link];
    let (p, f) = (point_in_link(pose, point), mat_t_vec(&pose.r, force));
    let ext = &mut ws.links[link].f_ext;
    if !ws.forced[link] {
        ws.forced[link] = true;
        *ext = Vec6::zero();
    }
    ext.ang = cross_add(p, f, ext.ang);
    ext.lin = add(ext.lin, f);
}
