//! Finding the contacts of a substep.

use super::contact_forces::{arm_response, arms, couple, gap_and_rate, hold, take_off_forces};
use super::distance::{Proximity, bound_bound, bound_box, rounded_box, rounded_rounded};
use crate::dynamics::kinematics::{point_in_link, point_velocity};
use crate::model::{Bound, Core, FixedBody, Model, Pair, Partner, Rounded};
use crate::robot::MAX_JOINTS_PER_ARM;
use crate::scalar::{Mask, Real};
use crate::spatial::{Vec3, Vec6, cross, dot, mat_vec, sub};
use crate::workspace::{Contact, OUTLOOK, Workspace};

/// Contacts are kept when they would push within a substep at their rate, or are this far from it (m): what a joint at full torque gains in a substep.
const SLACK: f64 = 0.005;

#[inline(always)]
fn distance<S: Real>(a: Vec3<S>, b: Vec3<S>) -> S {
    let d = sub(a, b);
    dot(d, d).sqrt()
}

/// Places the links' bounding capsules. Reads `ws.poses`.
#[inline(always)]
pub(super) fn place_bounds<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for (i, pose) in ws.poses.iter().enumerate() {
        let bound = model.collision.link(i).bound.placed(&pose.r, pose.o);
        ws.contacts.middles[i] = bound.middle();
        ws.contacts.bounds[i] = bound;
    }
}

/// A distance that the gap of a pair is not below (m), by balls and boxes around the bounding capsules.
#[inline(always)]
pub(super) fn coarse_gap<S: Real>(model: &Model<S>, ws: &Workspace<S>, pair: &Pair<S>) -> S {
    let a = ws.contacts.middles[pair.a];
    match pair.b {
        Partner::Link(b) => distance(a, ws.contacts.middles[b]) - pair.reach,
        Partner::Fixed(b) => match &model.collision.fixed[b] {
            FixedBody::Rounded(_, bound) => distance(a, bound.middle()) - pair.reach,
            FixedBody::Box(block) => bound_box(&ws.contacts.bounds[pair.a], block),
        },
    }
}

/// Speeds that the gap of a pair is not expected to close faster than in this period, and for [`OUTLOOK`] (m/s).
#[inline(always)]
fn closing_speeds<S: Real>(model: &Model<S>, ws: &Workspace<S>, pair: &Pair<S>) -> (S, S) {
    let set = &ws.contacts;
    match pair.b {
        Partner::Fixed(_) => (set.speeds[pair.a], set.speeds_ahead[pair.a]),
        Partner::Link(b) => {
            let ahead = set.speeds_ahead[pair.a] + set.speeds_ahead[b];
            let joints = &model.joints;
            let arm = joints.arm_of(b);
            if arm != joints.arm_of(pair.a) {
                return (set.speeds[pair.a] + set.speeds[b], ahead);
            }
            // Within an arm only the joints between the two count.
            let first = joints.of_arm(arm).start;
            let levers = &model.collision.link(pair.a).levers;
            let mut speed = S::zero();
            for j in b + 1..=pair.a {
                speed = levers[j - first].mul_add(set.rates[j], speed);
            }
            (speed, speed.min(ahead))
        }
    }
}

/// Bounds the links' speeds by what they do now. Reads `ws.poses` and the bounds.
#[inline(always)]
fn look_ahead<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for (i, pose) in ws.poses.iter().enumerate() {
        let v = ws.links[i].v;
        let bound = &model.collision.link(i).bound;
        let middle = ws.contacts.middles[i];
        let spin = sub(mat_vec(&pose.r, v.ang), ws.base_v.ang);
        let of_link = mat_vec(&pose.r, point_velocity(v, bound.middle()));
        let travel = sub(of_link, point_velocity(ws.base_v, middle));
        let reach = S::splat(0.5) * distance(bound.from, bound.to) + bound.radius;
        let speed = reach.mul_add(dot(spin, spin).sqrt(), dot(travel, travel).sqrt());
        // Half as much again and some, because poses and torques change.
        let ahead = speed.mul_add(S::splat(1.5), S::splat(0.15));
        ws.contacts.speeds_ahead[i] = ahead.min(ws.contacts.speeds[i]);
    }
}

/// The nearest of two proximities, lane by lane.
#[inline(always)]
fn nearer<S: Real>(a: Proximity<S>, b: Proximity<S>) -> Proximity<S> {
    let m = b.gap.lt(a.gap);
    let mut out = a;
    out.gap = S::select(m, b.gap, a.gap);
    for i in 0..3 {
        out.normal[i] = S::select(m, b.normal[i], a.normal[i]);
        out.point[i] = S::select(m, b.point[i], a.point[i]);
    }
    out
}

/// A proximity of which only a lower bound of the gap is known.
#[inline(always)]
fn no_nearer_than<S: Real>(gap: S) -> Proximity<S> {
    Proximity { gap, normal: [S::zero(); 3], point: [S::zero(); 3] }
}

/// The closest surfaces of a pair, in the `lanes` and where they are nearer than `range`; elsewhere a gap that is no nearer than the real one.
/// Reads `ws.poses` and the bounds.
///
/// Every test by which work is spared is a lane's own, and its result is put in by lane: whether the work is done for the sake of another lane makes
/// no difference.
#[inline(always)]
pub(super) fn proximity<S: Real>(
    model: &Model<S>,
    ws: &Workspace<S>,
    pair: &Pair<S>,
    mut lanes: S::Mask,
    range: S,
) -> Proximity<S> {
    let collision = &model.collision;
    let mut best = no_nearer_than(S::splat(f64::INFINITY));
    let (others, pose_b, bound_b) = match pair.b {
        Partner::Link(b) => {
            (Some(&collision.link(b).shapes), Some(&ws.poses[b]), Some(&ws.contacts.bounds[b]))
        }
        Partner::Fixed(b) => match &collision.fixed[b] {
            FixedBody::Box(_) => (None, None, None),
            FixedBody::Rounded(shapes, bound) => (Some(shapes), None, Some(bound)),
        },
    };
    let mut beyond = S::splat(f64::INFINITY);
    if let (Some(bound_b), false) = (bound_b, pair.simple) {
        let gap = bound_bound(&ws.contacts.bounds[pair.a], bound_b);
        let near = lanes & gap.lt(range);
        beyond = S::select(near, beyond, gap);
        lanes = near;
        if !lanes.any() {
            return no_nearer_than(gap);
        }
    }
    let pose_a = &ws.poses[pair.a];
    for shape in &collision.link(pair.a).shapes {
        let a = Rounded { core: shape.core.placed(&pose_a.r, pose_a.o), radius: shape.radius };
        let bound_a = Bound::of(&a);
        let Some(others) = others else {
            let Partner::Fixed(b) = pair.b else { continue };
            let FixedBody::Box(block) = &collision.fixed[b] else { continue };
            let bound = bound_box(&bound_a, block);
            let near = lanes & bound.lt(range.min(best.gap));
            if near.any() {
                let mut found = rounded_box(&a, block);
                found.gap = S::select(near, found.gap, bound);
                best = nearer(best, found);
            } else {
                best = nearer(best, no_nearer_than(bound));
            }
            continue;
        };
        for other in others {
            let mut b = *other;
            if let Some(pose) = pose_b {
                b.core = b.core.placed(&pose.r, pose.o);
            }
            if let (Core::Segment { .. }, Core::Segment { .. }) = (&a.core, &b.core) {
                // No bound is cheaper.
                best = nearer(best, rounded_rounded(&a, &b));
                continue;
            }
            let bound = bound_bound(&bound_a, &Bound::of(&b));
            let near = lanes & bound.lt(range.min(best.gap));
            if near.any() {
                let mut found = rounded_rounded(&a, &b);
                found.gap = S::select(near, found.gap, bound);
                best = nearer(best, found);
            } else {
                best = nearer(best, no_nearer_than(bound));
            }
        }
    }
    best.gap = S::select(lanes, best.gap, beyond);
    best
}

/// Finds the contacts of a substep of length `h` that starts `now` after the period did (s), with the mass each pushes against. Reads
/// `poses`, `sin`, `cos`, `v`, `u_col`, `d_inv` of the links.
///
/// A pair sleeps until its gap, closing at the expected speed, may come into the contact's reach. Each lane has its own alarm and takes no part
/// before it, so that whether a pair is looked at for another lane's sake makes no difference.
#[inline(always)]
pub(crate) fn find<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, now: f64, h: f64) {
    place_bounds(model, ws);
    take_off_forces(model, ws);
    ws.contacts.contacts.clear();
    let t = S::splat(now);
    // The damper's reach, and what closes within the substep.
    let horizon = ws.contacts.damping / ws.contacts.stiffness + S::splat(h);
    let slack = S::splat(SLACK);
    if now >= ws.contacts.next_look {
        look_ahead(model, ws);
        ws.contacts.next_look = now + OUTLOOK;
    }
    let scans = now >= ws.contacts.next_scan;
    if scans {
        ws.contacts.next_scan = OUTLOOK * ((now / OUTLOOK).floor() + 1.0);
        ws.contacts.list_due();
    }
    ws.contacts.touched.fill(false);
    for due in 0..ws.contacts.due.len() {
        let pair = ws.contacts.due[due];
        let awake = ws.contacts.wake[pair].le(t);
        if !awake.any() {
            continue;
        }
        let bodies = model.collision.pairs[pair];
        let (speed, ahead) = closing_speeds(model, ws, &bodies);
        let range = horizon.mul_add(ahead, slack);
        let mut gap = coarse_gap(model, ws, &bodies);
        let close = awake & gap.lt(range);
        let mut p = None;
        if close.any() {
            let found = proximity(model, ws, &bodies, close, range);
            gap = S::select(close, found.gap, gap);
            p = Some(found);
        }
        let margin = (gap - range).max(S::zero());
        let sleep = (margin / speed).max((margin / ahead).min(S::splat(OUTLOOK)));
        // Alarms that are far off ring together, or each lane of a group would have the pair looked at in a substep of its own.
        let alarm = t + sleep;
        let together = S::splat(OUTLOOK) * (alarm * S::splat(1.0 / OUTLOOK)).floor();
        let alarm = S::select(together.gt(t), together, alarm);
        ws.contacts.wake[pair] = S::select(awake, alarm, ws.contacts.wake[pair]);
        let Some(p) = p else { continue };
        let lanes = close & gap.lt(range);
        if !lanes.any() {
            continue;
        }
        let on_b = crate::spatial::mul_add(-p.gap, p.normal, p.point);
        let unit = Vec6 { ang: cross(p.point, p.normal), lin: p.normal };
        let mut contact = Contact {
            pair,
            lanes,
            on_a: point_in_link(&ws.poses[bodies.a], p.point),
            on_b,
            normal: p.normal,
            mass: S::one(),
            hold: S::zero(),
            point: p.point,
            force: S::zero(),
            drive: S::zero(),
            others: 0,
            at_a: [S::zero(); MAX_JOINTS_PER_ARM],
            at_b: [S::zero(); MAX_JOINTS_PER_ARM],
        };
        if let Partner::Link(b) = bodies.b {
            contact.on_b = point_in_link(&ws.poses[b], on_b);
        }
        let (gap, rate, _) = gap_and_rate(model, ws, &contact);
        // Only what may come to push within the substep.
        contact.lanes = lanes & (gap + horizon * rate).lt(slack);
        if !contact.lanes.any() {
            continue;
        }
        contact.at_a = arm_response(model, ws, bodies.a, unit);
        if let Partner::Link(b) = bodies.b {
            let back = arm_response(model, ws, b, unit);
            let arm = model.joints.arm_of(b);
            for j in 0..model.joints.of_arm(arm).len() {
                if arm == model.joints.arm_of(bodies.a) {
                    contact.at_a[j] -= back[j];
                } else {
                    contact.at_b[j] = -back[j];
                }
            }
        }
        contact.hold = hold(model, ws, &contact);
        for (arm, _) in arms(model, &bodies, &contact) {
            if let Some(arm) = arm {
                ws.contacts.touched[arm] = true;
            }
        }
        ws.contacts.contacts.push(contact);
    }
    if scans {
        // Most have just been sent to sleep.
        ws.contacts.keep_due();
    }
    couple(model, ws);
}
