//! Closest points of two shapes, and cheap bounds of their distance, without branches on lane data.
//!
//! [Ericson 2005] C. Ericson, Real-Time Collision Detection, Morgan Kaufmann.

use crate::model::{Bound, Core, FixedBox, Rounded};
use crate::scalar::Real;
use crate::spatial::{Vec3, add, dot, mat_t_vec, mat_vec, mul_add, scale, sub};

/// How two shapes A and B stand to each other, base frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Proximity<S> {
    /// Distance of the surfaces (m), negative when they overlap.
    pub(crate) gap: S,
    /// From B to A, of length one.
    pub(crate) normal: Vec3<S>,
    /// A's surface point (m); B's is this minus gap times normal.
    pub(crate) point: Vec3<S>,
}

/// Rounds of alternating projections. From mid to mid, the error after six is below a millimetre where shapes touch.
const ROUNDS: usize = 6;

/// Below this distance of cores (m) the direction between them says nothing.
const COINCIDENT: f64 = 1e-5;

/// A distance (m) that the shapes within two capsules are not below; the distance itself, if they are the capsules.
#[inline(always)]
pub(crate) fn bound_bound<S: Real>(a: &Bound<S>, b: &Bound<S>) -> S {
    let (p, q) = segment_segment(a.from, a.to, b.from, b.to);
    let d = sub(p, q);
    dot(d, d).sqrt() - (a.radius + b.radius)
}

/// A distance (m) that the shapes within a capsule are not below from a box: that of a box around the capsule's segment, in the box's axes.
#[inline(always)]
pub(crate) fn bound_box<S: Real>(a: &Bound<S>, b: &FixedBox<S>) -> S {
    let (p, q) = (to_box(b, a.from), to_box(b, a.to));
    let mut e = [S::zero(); 3];
    for i in 0..3 {
        let beyond = p[i].min(q[i]) - b.half[i];
        let before = -b.half[i] - p[i].max(q[i]);
        e[i] = beyond.max(before).max(S::zero());
    }
    dot(e, e).sqrt() - a.radius
}

/// Two rounded shapes, cores in the base frame.
#[inline(always)]
pub(crate) fn rounded_rounded<S: Real>(a: &Rounded<S>, b: &Rounded<S>) -> Proximity<S> {
    let (p, q) = if let (Core::Segment { from: p0, to: p1 }, Core::Segment { from: q0, to: q1 }) =
        (&a.core, &b.core)
    {
        segment_segment(*p0, *p1, *q0, *q1)
    } else {
        let mut q = middle(&b.core);
        let mut p = q;
        for _ in 0..ROUNDS {
            p = project(&a.core, q);
            q = project(&b.core, p);
        }
        (p, q)
    };
    let away = sub(middle(&a.core), middle(&b.core));
    between(p, q, away, a.radius, b.radius)
}

/// A rounded shape, core in the base frame, and a box.
#[inline(always)]
pub(crate) fn rounded_box<S: Real>(a: &Rounded<S>, b: &FixedBox<S>) -> Proximity<S> {
    // In box axes about its centre.
    let c = match a.core {
        Core::Segment { from, to } => segment_to_box(to_box(b, from), to_box(b, to), b.half),
        Core::Cylinder { centre, axis, radius, half } => {
            let core = Core::Cylinder {
                centre: to_box(b, centre),
                axis: mat_t_vec(&b.rotation, axis),
                radius,
                half,
            };
            let mut p = middle(&core);
            for _ in 0..ROUNDS {
                p = project(&core, clamp3(p, b.half));
            }
            p
        }
    };
    // Signed distance of the core's point from the box: outside to the nearest point, inside to the nearest face.
    let e = sub(c, clamp3(c, b.half));
    let outside = dot(e, e).sqrt();
    let depth = [c[0].abs() - b.half[0], c[1].abs() - b.half[1], c[2].abs() - b.half[2]];
    let inside = depth[0].max(depth[1]).max(depth[2]);
    let zero = S::zero();
    let one = S::one();
    let x_first = depth[0].ge(inside);
    let y_first = depth[1].ge(inside) & !x_first;
    let face = [
        S::select(x_first, c[0].copy_sign_to(one), zero),
        S::select(y_first, c[1].copy_sign_to(one), zero),
        S::select(x_first | y_first, zero, c[2].copy_sign_to(one)),
    ];
    let clear = outside.gt(S::splat(COINCIDENT));
    let inv = S::select(clear, outside, one).recip();
    let mut n = scale(inv, e);
    for i in 0..3 {
        n[i] = S::select(clear, n[i], face[i]);
    }
    let gap = S::select(clear, outside, inside) - a.radius;
    let surface = mul_add(-a.radius, n, c);
    Proximity {
        gap,
        normal: mat_vec(&b.rotation, n),
        point: add(mat_vec(&b.rotation, surface), b.centre),
    }
}

#[inline(always)]
fn between<S: Real>(p: Vec3<S>, q: Vec3<S>, away: Vec3<S>, ra: S, rb: S) -> Proximity<S> {
    let d = sub(p, q);
    let length = dot(d, d).sqrt();
    let clear = length.gt(S::splat(COINCIDENT));
    let far = dot(away, away).sqrt();
    let inv_far = S::select(far.gt(S::splat(COINCIDENT)), far, S::one()).recip();
    let inv = S::select(clear, length, S::one()).recip();
    let mut n = [S::zero(); 3];
    for i in 0..3 {
        n[i] = S::select(clear, d[i] * inv, away[i] * inv_far);
    }
    Proximity { gap: length - (ra + rb), normal: n, point: mul_add(-ra, n, p) }
}

#[inline(always)]
fn to_box<S: Real>(b: &FixedBox<S>, p: Vec3<S>) -> Vec3<S> {
    mat_t_vec(&b.rotation, sub(p, b.centre))
}

#[inline(always)]
fn clamp3<S: Real>(p: Vec3<S>, half: Vec3<S>) -> Vec3<S> {
    [p[0].clamp(-half[0], half[0]), p[1].clamp(-half[1], half[1]), p[2].clamp(-half[2], half[2])]
}

#[inline(always)]
fn middle<S: Real>(core: &Core<S>) -> Vec3<S> {
    match *core {
        Core::Segment { from, to } => scale(S::splat(0.5), add(from, to)),
        Core::Cylinder { centre, .. } => centre,
    }
}

/// Nearest point of a core.
#[inline(always)]
fn project<S: Real>(core: &Core<S>, p: Vec3<S>) -> Vec3<S> {
    match *core {
        Core::Segment { from, to } => {
            let d = sub(to, from);
            let dd = dot(d, d).max(S::splat(1e-12));
            let t = (dot(sub(p, from), d) / dd).clamp(S::zero(), S::one());
            mul_add(t, d, from)
        }
        Core::Cylinder { centre, axis, radius, half } => {
            let r = sub(p, centre);
            let z = dot(r, axis);
            let radial = mul_add(-z, axis, r);
            let rho = dot(radial, radial).sqrt();
            let shrink = radius / rho.max(radius);
            let on_axis = mul_add(z.clamp(-half, half), axis, centre);
            mul_add(shrink, radial, on_axis)
        }
    }
}

/// Closest points of two segments [Ericson 2005, §5.1.9], in the middle of the overlap where they are parallel; within half a degree of that up to 2 mm
/// too far apart for links as long as an upper arm.
#[inline(always)]
fn segment_segment<S: Real>(
    p0: Vec3<S>,
    p1: Vec3<S>,
    q0: Vec3<S>,
    q1: Vec3<S>,
) -> (Vec3<S>, Vec3<S>) {
    let (zero, one) = (S::zero(), S::one());
    let tiny = S::splat(1e-12);
    let (d1, d2, r) = (sub(p1, p0), sub(q1, q0), sub(p0, q0));
    let a = dot(d1, d1).max(tiny);
    let e = dot(d2, d2).max(tiny);
    let b = dot(d1, d2);
    let c = dot(d1, r);
    let f = dot(d2, r);
    let denominator = b.neg_mul_add(b, a * e);
    let skew = denominator.gt(S::splat(1e-4) * (a * e));
    // Parallel: the part of A that lies beside B, from the parameters of B's ends on A.
    let (t0, t1) = (-c / a, (b - c) / a);
    let low = t0.min(t1).clamp(zero, one);
    let high = t0.max(t1).clamp(zero, one);
    let s = c.neg_mul_add(e, b * f) / S::select(skew, denominator, one);
    let s = S::select(skew, s.clamp(zero, one), S::splat(0.5) * (low + high));
    let t = (b.mul_add(s, f) / e).clamp(zero, one);
    let s = (b.mul_add(t, -c) / a).clamp(zero, one);
    (mul_add(s, d1, p0), mul_add(t, d2, q0))
}

/// The point of a segment nearest to the box [−half, half], exactly; in the middle where several are.
///
/// The squared distance along the segment is convex, its derivative g grows and is linear between the at most six parameters at which a coordinate
/// passes a face. So the zero of g lies between the largest of those (and the ends) with g ≤ 0 and the smallest with g ≥ 0.
#[inline(always)]
fn segment_to_box<S: Real>(from: Vec3<S>, to: Vec3<S>, half: Vec3<S>) -> Vec3<S> {
    let (zero, one) = (S::zero(), S::one());
    let d = sub(to, from);
    let (mut low, mut g_low) = (zero, slope(from, d, half, zero));
    let (mut high, mut g_high) = (one, slope(from, d, half, one));
    for axis in 0..3 {
        let moving = d[axis].abs().gt(S::splat(1e-9));
        let inv = S::select(moving, d[axis], one).recip();
        for face in [half[axis], -half[axis]] {
            let t = ((face - from[axis]) * inv).clamp(zero, one);
            let g = slope(from, d, half, t);
            let below = g.le(zero) & t.gt(low);
            low = S::select(below, t, low);
            g_low = S::select(below, g, g_low);
            let above = g.ge(zero) & t.lt(high);
            high = S::select(above, t, high);
            g_high = S::select(above, g, g_high);
        }
    }
    // Monotone at the ends: g > 0 everywhere leaves the start, g < 0 everywhere the end.
    let rise = g_high - g_low;
    let linear = rise.gt(S::splat(1e-9));
    let share = S::select(linear, -g_low / S::select(linear, rise, one), S::splat(0.5));
    let t = share.clamp(zero, one).mul_add(high - low, low);
    let t = S::select(g_low.gt(zero), zero, t);
    let t = S::select(g_high.lt(zero), one, t);
    mul_add(t, d, from)
}

/// Half the derivative of the squared distance to the box along from + t d.
#[inline(always)]
fn slope<S: Real>(from: Vec3<S>, d: Vec3<S>, half: Vec3<S>, t: S) -> S {
    let p = mul_add(t, d, from);
    dot(sub(p, clamp3(p, half)), d)
}
