//! Finding contacts and pushing at them.

use super::distance::{Proximity, rounded_box, rounded_rounded};
use super::model::{FixedBody, Pair, Partner};
use super::shape::Rounded;
use super::{DAMPING_RATIO, FREQUENCY, HEAVIEST, SLACK};
use crate::dynamics::kinematics::{force_from_next, point_in_link, point_velocity, turn};
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
    /// Mass the joints show along the normal, less what other contacts take of it (kg).
    mass: S,
    /// Whether it pushes at the start of the substep.
    pushes: S::Mask,
    /// What a unit force along the normal leaves at the joints of A's arm, and of B's where that is another (see [`arm_response`]).
    at_a: Response<S>,
    at_b: Response<S>,
}

/// A force carried up an arm: u at each joint.
type Response<S> = [S; JOINTS_PER_ARM];

/// Contacts of a substep, and what tells when a pair must be looked at again.
#[derive(Clone, Debug)]
pub(crate) struct ContactSet<S: Real> {
    contacts: Vec<Contact<S>>,
    /// ω² (1/s²) and 2 ζ ω (1/s) of contacts and stops.
    stiffness: S,
    damping: S,
    /// Bounding centres of the links, base frame (m).
    centres: Vec<Vec3<S>>,
    /// Rate that no joint is expected to exceed in the period (rad/s).
    rates: Vec<S>,
    /// Speed against the base that no point of a link is expected to exceed in the period (m/s).
    speeds: Vec<S>,
    /// When each pair may come into reach, since the period's start (s), and the lowest lane of that.
    wake: Vec<S>,
    wake_lowest: Vec<f64>,
}

impl<S: Real> ContactSet<S> {
    /// Room for all pairs of `model`.
    pub(crate) fn new(model: &Model<S>) -> Self {
        let (n_pairs, n) = (model.collision.pairs.len(), model.n_joints());
        let zero = S::zero();
        Self {
            contacts: Vec::with_capacity(n_pairs),
            stiffness: zero,
            damping: zero,
            centres: vec![[zero; 3]; n],
            rates: vec![zero; n],
            speeds: vec![zero; n],
            wake: vec![zero; n_pairs],
            wake_lowest: vec![0.0; n_pairs],
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
        }
        for i in 0..self.wake.len() {
            self.wake[i] = S::zero();
            self.wake_lowest[i] = 0.0;
        }
        let frequency = FREQUENCY.min(stable);
        self.stiffness = S::splat(frequency * frequency);
        self.damping = S::splat(2.0 * DAMPING_RATIO * frequency);
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
    for link in &mut ws.links {
        link.f_ext = Vec6::zero();
    }
}

/// Whether the last narrow phase found a contact in some lane.
#[inline(always)]
pub(crate) fn any_contact<S: Real>(ws: &Workspace<S>) -> bool {
    !ws.contacts.contacts.is_empty()
}

#[inline(always)]
fn distance<S: Real>(a: Vec3<S>, b: Vec3<S>) -> S {
    let d = sub(a, b);
    dot(d, d).sqrt()
}

/// Places the links' bounding spheres. Reads `ws.poses`.
#[inline(always)]
fn place_spheres<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for (i, pose) in ws.poses.iter().enumerate() {
        let centre = model.collision.links[i % JOINTS_PER_ARM].centre;
        ws.contacts.centres[i] = add(mat_vec(&pose.r, centre), pose.o);
    }
}

/// A distance that the gap of a pair is not below (m), by spheres.
#[inline(always)]
fn sphere_gap<S: Real>(model: &Model<S>, ws: &Workspace<S>, pair: &Pair<S>) -> S {
    let collision = &model.collision;
    let a = ws.contacts.centres[pair.a];
    let d = match pair.b {
        Partner::Link(b) => distance(a, ws.contacts.centres[b]),
        Partner::Fixed(b) => match &collision.fixed[b] {
            FixedBody::Rounded(_) => distance(a, collision.fixed_centres[b]),
            FixedBody::Box(block) => {
                let p = mat_t_vec(&block.rotation, sub(a, block.centre));
                let h = block.half;
                let e = [
                    (p[0].abs() - h[0]).max(S::zero()),
                    (p[1].abs() - h[1]).max(S::zero()),
                    (p[2].abs() - h[2]).max(S::zero()),
                ];
                dot(e, e).sqrt()
            }
        },
    };
    d - pair.reach
}

/// Speed that the gap of a pair is not expected to close faster than in this period (m/s).
#[inline(always)]
fn closing_speed<S: Real>(model: &Model<S>, ws: &Workspace<S>, pair: &Pair<S>) -> S {
    let set = &ws.contacts;
    match pair.b {
        Partner::Fixed(_) => set.speeds[pair.a],
        Partner::Link(b) if b / JOINTS_PER_ARM != pair.a / JOINTS_PER_ARM => {
            set.speeds[pair.a] + set.speeds[b]
        }
        Partner::Link(b) => {
            // Within an arm only the joints between the two count.
            let (first, l) = (b - b % JOINTS_PER_ARM, pair.a % JOINTS_PER_ARM);
            let mut speed = S::zero();
            for j in b % JOINTS_PER_ARM + 1..=l {
                speed = model.collision.levers[j][l].mul_add(set.rates[first + j], speed);
            }
            speed
        }
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

/// The closest surfaces of a pair. Reads `ws.poses`.
#[inline(always)]
fn proximity<S: Real>(model: &Model<S>, ws: &Workspace<S>, pair: &Pair<S>) -> Proximity<S> {
    let collision = &model.collision;
    let zero = [S::zero(); 3];
    let mut best = Proximity { gap: S::splat(f64::INFINITY), normal: zero, point: zero };
    let pose_a = &ws.poses[pair.a];
    for shape in &collision.links[pair.a % JOINTS_PER_ARM].shapes {
        let a = Rounded { core: shape.core.placed(&pose_a.r, pose_a.o), radius: shape.radius };
        let (others, pose_b) = match pair.b {
            Partner::Link(b) => (&collision.links[b % JOINTS_PER_ARM].shapes, Some(&ws.poses[b])),
            Partner::Fixed(b) => match &collision.fixed[b] {
                FixedBody::Box(block) => {
                    best = nearer(best, rounded_box(&a, block));
                    continue;
                }
                FixedBody::Rounded(shapes) => (shapes, None),
            },
        };
        for other in others {
            let mut b = *other;
            if let Some(pose) = pose_b {
                b.core = b.core.placed(&pose.r, pose.o);
            }
            best = nearer(best, rounded_rounded(&a, &b));
        }
    }
    best
}

/// Finds the contacts of a substep of length `h` that starts `now` after the period did (s), with the mass each pushes against. Reads
/// `poses`, `sin`, `cos`, `v`, `u_col`, `d_inv` of the links.
///
/// A pair sleeps until its gap, closing at the expected speed, may come into the contact's reach. Each lane has its own alarm and takes no part
/// before it, so that whether a pair is looked at for another lane's sake makes no difference.
#[inline(always)]
pub(crate) fn find<S: Real>(model: &Model<S>, ws: &mut Workspace<S>, now: f64, h: f64) {
    place_spheres(model, ws);
    ws.contacts.contacts.clear();
    let t = S::splat(now);
    // The damper's reach, and what closes within the substep.
    let horizon = ws.contacts.damping / ws.contacts.stiffness + S::splat(h);
    let slack = S::splat(SLACK);
    for pair in 0..model.collision.pairs.len() {
        if ws.contacts.wake_lowest[pair] > now {
            continue;
        }
        let bodies = model.collision.pairs[pair];
        let awake = ws.contacts.wake[pair].le(t);
        let speed = closing_speed(model, ws, &bodies);
        let range = horizon.mul_add(speed, slack);
        let mut gap = sphere_gap(model, ws, &bodies);
        let close = awake & gap.lt(range);
        let mut p = None;
        if close.any() {
            let found = proximity(model, ws, &bodies);
            gap = S::select(close, found.gap, gap);
            p = Some(found);
        }
        let sleep = (gap - range) / speed;
        let sleep = S::select(sleep.gt(S::zero()), sleep, S::zero());
        let wake = S::select(awake, t + sleep, ws.contacts.wake[pair]);
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
            pushes: lanes,
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
        contact.pushes = contact.lanes & drive(&ws.contacts, gap, rate).gt(S::zero());
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
        ws.contacts.contacts.push(contact);
    }
    share(model, ws);
}

/// Gives each contact the mass 1 / Σⱼ |Wᵢⱼ| over itself and the contacts that push, W = J M⁻¹ Jᵀ along the normals.
///
/// Alone that is the mass the joints show. Together, by Gershgorin's theorem, no mode of the contacts is stiffer than a single one's.
#[inline(always)]
fn share<S: Real>(model: &Model<S>, ws: &mut Workspace<S>) {
    for i in 0..ws.contacts.contacts.len() {
        let contact = ws.contacts.contacts[i];
        let mut sum = S::splat(1.0 / HEAVIEST) + coupling(model, ws, &contact, &contact);
        for j in 0..ws.contacts.contacts.len() {
            let other = &ws.contacts.contacts[j];
            if j != i && other.pushes.any() {
                let w = coupling(model, ws, &contact, other).abs();
                sum += S::select(other.pushes, w, S::zero());
            }
        }
        ws.contacts.contacts[i].mass = sum.recip();
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
        f = force_from_next(&model.links[i % JOINTS_PER_ARM], f);
    }
}

/// ω² g + 2 ζ ω v, negated: what pushes where it is positive (m/s²).
#[inline(always)]
fn drive<S: Real>(set: &ContactSet<S>, gap: S, rate: S) -> S {
    -set.stiffness.mul_add(gap, set.damping * rate)
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
        let bodies = &model.collision.pairs[contact.pair];
        let (gap, rate, point) = gap_and_rate(model, ws, &contact);
        let size = (contact.mass * drive(&ws.contacts, gap, rate)).max(S::zero());
        let size = S::select(contact.lanes, size, S::zero());
        let mut force = scale(size, contact.normal);
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
    place_spheres(model, ws);
    let mut penetration = S::zero();
    for pair in &model.collision.pairs {
        let near = sphere_gap(model, ws, pair).lt(S::zero());
        if !near.any() {
            continue;
        }
        let p = proximity(model, ws, pair);
        let touches = near & p.gap.lt(S::zero());
        pairs += S::select(touches, S::one(), S::zero());
        penetration = S::select(touches, (-p.gap).max(penetration), penetration);
    }
    Touching { pairs, penetration }
}
