//! Finding contacts and pushing at them.

use super::distance::{Proximity, bound_bound, bound_box, rounded_box, rounded_rounded};
use super::model::{FixedBody, Pair, Partner};
use super::shape::{Bound, Core, Rounded};
use super::{DAMPING_RATIO, FREQUENCY, HEAVIEST, HELD, SLACK, SWEEPS};
use crate::dynamics::kinematics::{
    for_sparsity, force_from_next, point_in_link, point_velocity, turn,
};
use crate::dynamics::{Workspace, stop_interval};
use crate::robot::{JOINTS_PER_ARM, Model};
use crate::scalar::{Kernel, Mask, Real};
use crate::spatial::{Vec3, Vec6, add, cross, cross_add, dot, mat_t_vec, mat_vec, scale, sub};
use crate::state::State;

/// A point at which two bodies push each other, for the length of a substep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Contact<S: Real> {
    pair: usize,
    /// Lanes in which the pair is near.
    lanes: S::Mask,
    /// Surface points, fixed to the bodies: A's in its link frame, B's in its link frame or the base frame (m).
    on_a: Vec3<S>,
    on_b: Vec3<S>,
    /// From B to A, fixed to the base.
    normal: Vec3<S>,
    /// Mass the joints show along the normal (kg).
    mass: S,
    /// Acceleration that torques alone would give the gap at the start of the substep, as far as it closes it and is held against (m/s²).
    hold: S,
    /// A's point in the base frame (m), and the force (N), at the last look.
    point: Vec3<S>,
    force: S,
    /// Acceleration that the gap shall have at least (m/s²).
    drive: S,
    /// Where its row of `couplings` begins.
    others: usize,
    /// What a unit force along the normal leaves at the joints of A's arm, and of B's where that is another (see [`arm_response`]).
    at_a: Response<S>,
    at_b: Response<S>,
}

/// How long joints take to follow a new command, all but for a small part (s).
const SETTLING: f64 = 0.06;

/// How long the motion at hand says something about speeds (s).
const OUTLOOK: f64 = 0.1;

/// A force carried up an arm: u at each joint.
type Response<S> = [S; JOINTS_PER_ARM];

/// Contacts of a substep, and what tells when a pair must be looked at again.
#[derive(Clone, Debug)]
pub(crate) struct ContactSet<S: Real> {
    contacts: Vec<Contact<S>>,
    /// Off the diagonal of W (1/kg), contact by contact: which other contact, and how much a unit of its force accelerates the gap.
    couplings: Vec<(usize, S)>,
    /// ω² (1/s²) and 2 ζ ω (1/s) of contacts and stops.
    stiffness: S,
    damping: S,
    /// Bounding capsules of the links, base frame, and their middles (m).
    bounds: Vec<Bound<S>>,
    middles: Vec<Vec3<S>>,
    /// Torques at the joints without the contacts (N m), see [`take_off_forces`].
    free: Vec<S>,
    /// Rate that no joint is expected to exceed in the period (rad/s).
    rates: Vec<S>,
    /// Speed against the base that no point of a link is expected to exceed in the period, whatever the pose (m/s).
    speeds: Vec<S>,
    /// Speed that none is expected to exceed for [`OUTLOOK`] (m/s): from the motion at hand, or `speeds` while joints still follow a new command.
    speeds_ahead: Vec<S>,
    /// When `speeds_ahead` is looked at again, since the period's start (s).
    next_look: f64,
    /// When each pair may come into reach, since the period's start (s), and the lowest lane of that.
    wake: Vec<S>,
    wake_lowest: Vec<f64>,
    /// Pairs with an alarm before `next_scan`, in ascending order; when all are looked through again, since the period's start (s).
    due: Vec<usize>,
    next_scan: f64,
    /// Whether some contact of the substep is one of each arm.
    touched: Vec<bool>,
}

impl<S: Real> ContactSet<S> {
    /// Room for all pairs of `model`.
    pub(crate) fn new(model: &Model<S>) -> Self {
        let (n_pairs, n) = (model.collision.pairs.len(), model.n_joints());
        let zero = S::zero();
        Self {
            contacts: Vec::with_capacity(n_pairs),
            couplings: Vec::with_capacity(n_pairs),
            stiffness: zero,
            damping: zero,
            bounds: vec![Bound { from: [zero; 3], to: [zero; 3], radius: zero }; n],
            middles: vec![[zero; 3]; n],
            free: vec![zero; n],
            rates: vec![zero; n],
            speeds: vec![zero; n],
            speeds_ahead: vec![zero; n],
            next_look: 0.0,
            wake: vec![zero; n_pairs],
            wake_lowest: vec![0.0; n_pairs],
            due: Vec::with_capacity(n_pairs),
            next_scan: 0.0,
            touched: vec![false; model.n_arms()],
        }
    }

    /// Begins a control period: sets the stiffness of contacts and stops, softer where only frequencies up to `stable` (rad/s) are, and bounds speeds by rates and commands
    /// (rad/s).
    #[inline(always)]
    pub(crate) fn begin_period(&mut self, model: &Model<S>, stable: f64, qd: &[S], command: &[S]) {
        for i in 0..self.rates.len() {
            // A quarter more than asked for, because other joints and contacts drag.
            let rate = qd[i].abs().max(command[i].abs());
            self.rates[i] = rate.mul_add(S::splat(1.25), S::splat(0.1));
        }
        for i in 0..self.speeds.len() {
            let (first, l) = (i - i % JOINTS_PER_ARM, i % JOINTS_PER_ARM);
            let mut speed = S::zero();
            for j in 0..=l {
                speed = model.collision.levers[j][l].mul_add(self.rates[first + j], speed);
            }
            self.speeds[i] = speed;
            self.speeds_ahead[i] = speed;
        }
        self.next_look = SETTLING;
        self.next_scan = 0.0;
        self.contacts.clear();
        for i in 0..self.wake.len() {
            self.wake[i] = S::zero();
            self.wake_lowest[i] = 0.0;
        }
        let frequency = FREQUENCY.min(stable);
        self.stiffness = S::splat(frequency * frequency);
        self.damping = S::splat(2.0 * DAMPING_RATIO * frequency);
    }

    /// Lists the pairs with an alarm before the next scan.
    #[inline(always)]
    fn list_due(&mut self) {
        self.due.clear();
        for (pair, &wake) in self.wake_lowest.iter().enumerate() {
            if wake < self.next_scan {
                self.due.push(pair);
            }
        }
    }

    /// ω² (1/s²) and 2 ζ ω (1/s) of contacts and stops.
    #[inline(always)]
    pub(crate) fn rates(&self) -> (S, S) {
        (self.stiffness, self.damping)
    }
}

/// Takes all outside forces off base and links.
#[inline(always)]
pub(crate) fn clear<S: Real>(ws: &mut Workspace<S>) {
    ws.base_f_ext = Vec6::zero();
    ws.forced.fill(false);
}

/// Whether the last narrow phase found a contact in some lane.
#[inline(always)]
pub(crate) fn any_contact<S: Real>(ws: &Workspace<S>) -> bool {
    !ws.contacts.contacts.is_empty()
}

/// Whether some contact is one of this arm.
#[inline(always)]
pub(crate) fn touches_arm<S: Real>(ws: &Workspace<S>, arm: usize) -> bool {
    ws.contacts.touched[arm]
}

#[inline(always)]
fn distance<S: Real>(a: Vec3<S>, b: Vec3<S>) -> S {
    let d = sub(a, b);
    dot(d, d).sqrt()
}

/// Places the links' bounding capsules. Reads `ws.poses`.
#[inline(always)]
fn place_bounds<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for (i, pose) in ws.poses.iter().enumerate() {
        let bound = model.collision.links[i % JOINTS_PER_ARM].bound.placed(&pose.r, pose.o);
        ws.contacts.middles[i] = bound.middle();
        ws.contacts.bounds[i] = bound;
    }
}

/// A distance that the gap of a pair is not below (m), by balls and boxes around the bounding capsules.
#[inline(always)]
fn coarse_gap<S: Real>(model: &Model<S>, ws: &Workspace<S>, pair: &Pair<S>) -> S {
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
            if b / JOINTS_PER_ARM != pair.a / JOINTS_PER_ARM {
                return (set.speeds[pair.a] + set.speeds[b], ahead);
            }
            // Within an arm only the joints between the two count.
            let (first, l) = (b - b % JOINTS_PER_ARM, pair.a % JOINTS_PER_ARM);
            let mut speed = S::zero();
            for j in b % JOINTS_PER_ARM + 1..=l {
                speed = model.collision.levers[j][l].mul_add(set.rates[first + j], speed);
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
        let bound = &model.collision.links[i % JOINTS_PER_ARM].bound;
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
fn proximity<S: Real>(
    model: &Model<S>,
    ws: &Workspace<S>,
    pair: &Pair<S>,
    mut lanes: S::Mask,
    range: S,
) -> Proximity<S> {
    let collision = &model.collision;
    let mut best = no_nearer_than(S::splat(f64::INFINITY));
    let (others, pose_b, bound_b) = match pair.b {
        Partner::Link(b) => (
            Some(&collision.links[b % JOINTS_PER_ARM].shapes),
            Some(&ws.poses[b]),
            Some(&ws.contacts.bounds[b]),
        ),
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
    for shape in &collision.links[pair.a % JOINTS_PER_ARM].shapes {
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
        if ws.contacts.wake_lowest[pair] > now {
            continue;
        }
        let bodies = model.collision.pairs[pair];
        let awake = ws.contacts.wake[pair].le(t);
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
        let wake = S::select(awake, alarm, ws.contacts.wake[pair]);
        ws.contacts.wake[pair] = wake;
        ws.contacts.wake_lowest[pair] = wake.lowest();
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
            at_a: [S::zero(); JOINTS_PER_ARM],
            at_b: [S::zero(); JOINTS_PER_ARM],
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
            for j in 0..JOINTS_PER_ARM {
                if b / JOINTS_PER_ARM == bodies.a / JOINTS_PER_ARM {
                    contact.at_a[j] -= back[j];
                } else {
                    contact.at_b[j] = -back[j];
                }
            }
        }
        contact.hold = hold(model, ws, &contact);
        for (arm, _) in arms(&bodies, &contact) {
            if let Some(arm) = arm {
                ws.contacts.touched[arm] = true;
            }
        }
        ws.contacts.contacts.push(contact);
    }
    if scans {
        // Most have just been sent to sleep.
        ws.contacts.list_due();
    }
    couple(model, ws);
}

/// Leaves in `free` of the contact set what the last evaluation's torques were at each joint less what its contacts pushed: u of the second pass of the
/// articulated-body algorithm.
#[inline(always)]
fn take_off_forces<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for i in 0..ws.links.len() {
        ws.contacts.free[i] = ws.links[i].u;
    }
    for i in 0..ws.contacts.contacts.len() {
        let contact = ws.contacts.contacts[i];
        for (arm, response) in arms(&model.collision.pairs[contact.pair], &contact) {
            let Some(arm) = arm else { continue };
            for j in 0..JOINTS_PER_ARM {
                let u = &mut ws.contacts.free[arm * JOINTS_PER_ARM + j];
                *u = response[j].neg_mul_add(contact.force, *u);
            }
        }
    }
}

/// How much a contact holds against beforehand (m/s²): Σ u r / D is what the gap would accelerate with, the base held.
#[inline(always)]
fn hold<S: Real>(model: &Model<S>, ws: &Workspace<S>, contact: &Contact<S>) -> S {
    let mut free = S::zero();
    for (arm, response) in arms(&model.collision.pairs[contact.pair], contact) {
        let Some(arm) = arm else { continue };
        for j in 0..JOINTS_PER_ARM {
            let i = arm * JOINTS_PER_ARM + j;
            free = (response[j] * ws.links[i].d_inv).mul_add(ws.contacts.free[i], free);
        }
    }
    let held = (S::splat(-HELD) * free).max(S::zero());
    S::select(contact.lanes, held, S::zero())
}

/// Notes W = J M⁻¹ Jᵀ along the normals: the inverse of the mass that each contact shows, and what it feels of the others.
#[inline(always)]
fn couple<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
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
    for (one_arm, u) in arms(one_pair, one) {
        for (other_arm, v) in arms(other_pair, other) {
            if one_arm.is_some() && one_arm == other_arm {
                let first = one_arm.unwrap_or(0) * JOINTS_PER_ARM;
                for j in 0..JOINTS_PER_ARM {
                    sum = (u[j] * ws.links[first + j].d_inv).mul_add(v[j], sum);
                }
            }
        }
    }
    sum
}

/// The arms a contact pushes at, with its response there.
#[inline(always)]
fn arms<'a, S: Real>(
    pair: &Pair<S>,
    contact: &'a Contact<S>,
) -> [(Option<usize>, &'a Response<S>); 2] {
    let a = pair.a / JOINTS_PER_ARM;
    let b = match pair.b {
        Partner::Link(b) if b / JOINTS_PER_ARM != a => Some(b / JOINTS_PER_ARM),
        _ => None,
    };
    [(Some(a), &contact.at_a), (b, &contact.at_b)]
}

/// What the unit wrench (base frame, at its origin) on a link leaves at the joints of its arm, link by link up to the base.
///
/// u of the second pass of the articulated-body algorithm for that force alone: with D from there, Σ u²/D is what the link gives way, with
/// the base held. Contacts move bodies of one and the same robot against each other, so what the base gives way is small.
#[inline(always)]
fn arm_response<S: Real>(
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
    let mut response = [S::zero(); JOINTS_PER_ARM];
    let first = link - link % JOINTS_PER_ARM;
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
        let body = &model.links[i % JOINTS_PER_ARM];
        f = for_sparsity!(body.sparsity, sparsity => force_from_next(body, sparsity, f));
    }
}

/// Hold − ω² g − 2 ζ ω v: what pushes where it is positive (m/s²).
#[inline(always)]
fn drive<S: Real>(set: &ContactSet<S>, contact: &Contact<S>, gap: S, rate: S) -> S {
    set.stiffness.neg_mul_add(gap, set.damping.neg_mul_add(rate, contact.hold))
}

/// Gap of a contact, its rate, and A's point in the base frame.
#[inline(always)]
fn gap_and_rate<S: Real>(
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
    clear(ws);
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
fn push_link<S: Real>(ws: &mut Workspace<S>, link: usize, point: Vec3<S>, force: Vec3<S>) {
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

/// What touches, per lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touching<S> {
    /// Number of touching pairs of bodies, those told by joint angle included.
    pub pairs: S,
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
    crate::dynamics::kinematics_of(model, ws, state);
    let mut pairs = S::zero();
    for stop in &model.stops {
        for arm in 0..model.n_arms() {
            let first = arm * JOINTS_PER_ARM;
            let narrowing = &ws.links[first + stop.narrowing_joint];
            let q = state.q[first + stop.joint];
            let (x, half) = stop_interval(stop, q, narrowing.sin, narrowing.cos);
            pairs += S::select(x.abs().le(half), S::one(), S::zero());
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
        pairs += S::select(touches, S::one(), S::zero());
        penetration = S::select(touches, (-p.gap).max(penetration), penetration);
    }
    Touching { pairs, penetration }
}
