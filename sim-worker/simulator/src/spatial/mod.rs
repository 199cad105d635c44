//! Three-dimensional algebra of the hot path: small arrays, always inlined.
//!
//! nalgebra builds the model and the readable `f64` twins of the dynamics; here it is not used, because its functions are not
//! guaranteed to be inlined into the functions that are compiled for the processor's vector width (see [`crate::scalar`]).
//!
//! Names: `r_ab` is the rotation matrix that takes coordinates in frame b to coordinates in frame a; W is the world, B the base.

use crate::scalar::Real;

/// Vector of three coordinates.
pub type Vec3<S> = [S; 3];

/// Matrix of rows.
pub type Mat3<S> = [[S; 3]; 3];

/// Motion (angular, linear velocity) or force (moment, force) at a frame's origin, in the frame's axes [Featherstone 2008, ch. 2].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vec6<S> {
    /// Angular velocity or moment.
    pub ang: Vec3<S>,
    /// Linear velocity or force.
    pub lin: Vec3<S>,
}

impl<S: Real> Vec6<S> {
    /// Zero.
    #[inline(always)]
    pub fn zero() -> Self {
        Self { ang: [S::zero(); 3], lin: [S::zero(); 3] }
    }
}

/// a + b.
#[inline(always)]
pub fn add<S: Real>(a: Vec3<S>, b: Vec3<S>) -> Vec3<S> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// a − b.
#[inline(always)]
pub fn sub<S: Real>(a: Vec3<S>, b: Vec3<S>) -> Vec3<S> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// s a.
#[inline(always)]
pub fn scale<S: Real>(s: S, a: Vec3<S>) -> Vec3<S> {
    [s * a[0], s * a[1], s * a[2]]
}

/// s a + b.
#[inline(always)]
pub fn mul_add<S: Real>(s: S, a: Vec3<S>, b: Vec3<S>) -> Vec3<S> {
    [s.mul_add(a[0], b[0]), s.mul_add(a[1], b[1]), s.mul_add(a[2], b[2])]
}

/// a · b.
#[inline(always)]
pub fn dot<S: Real>(a: Vec3<S>, b: Vec3<S>) -> S {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

/// a × b.
#[inline(always)]
pub fn cross<S: Real>(a: Vec3<S>, b: Vec3<S>) -> Vec3<S> {
    [
        a[2].neg_mul_add(b[1], a[1] * b[2]),
        a[0].neg_mul_add(b[2], a[2] * b[0]),
        a[1].neg_mul_add(b[0], a[0] * b[1]),
    ]
}

/// c + a × b.
#[inline(always)]
pub fn cross_add<S: Real>(a: Vec3<S>, b: Vec3<S>, c: Vec3<S>) -> Vec3<S> {
    [
        a[2].neg_mul_add(b[1], a[1].mul_add(b[2], c[0])),
        a[0].neg_mul_add(b[2], a[2].mul_add(b[0], c[1])),
        a[1].neg_mul_add(b[0], a[0].mul_add(b[1], c[2])),
    ]
}

/// m a.
#[inline(always)]
pub fn mat_vec<S: Real>(m: &Mat3<S>, a: Vec3<S>) -> Vec3<S> {
    [dot(m[0], a), dot(m[1], a), dot(m[2], a)]
}

/// mᵀ a.
#[inline(always)]
pub fn mat_t_vec<S: Real>(m: &Mat3<S>, a: Vec3<S>) -> Vec3<S> {
    let mut r = scale(a[0], m[0]);
    r = mul_add(a[1], m[1], r);
    mul_add(a[2], m[2], r)
}

/// a b.
#[inline(always)]
pub fn mat_mat<S: Real>(a: &Mat3<S>, b: &Mat3<S>) -> Mat3<S> {
    [mat_t_vec(b, a[0]), mat_t_vec(b, a[1]), mat_t_vec(b, a[2])]
}

/// Rotation matrix of the unit quaternion (w, x, y, z).
#[inline(always)]
pub fn quaternion_to_rotation<S: Real>(q: &[S; 4]) -> Mat3<S> {
    let [w, x, y, z] = *q;
    let two = S::splat(2.0);
    let (x2, y2, z2) = (two * x, two * y, two * z);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    let (xy, xz, yz) = (x * y2, x * z2, y * z2);
    let one = S::one();
    [
        [z2.neg_mul_add(z, y2.neg_mul_add(y, one)), xy - wz, xz + wy],
        [xy + wz, z2.neg_mul_add(z, x2.neg_mul_add(x, one)), yz - wx],
        [xz - wy, yz + wx, y2.neg_mul_add(y, x2.neg_mul_add(x, one))],
    ]
}

/// Product of the quaternions a and b (w, x, y, z): first b, then a.
#[inline(always)]
pub fn quaternion_product<S: Real>(a: &[S; 4], b: &[S; 4]) -> [S; 4] {
    let [aw, ax, ay, az] = *a;
    let [bw, bx, by, bz] = *b;
    [
        az.neg_mul_add(bz, ay.neg_mul_add(by, ax.neg_mul_add(bx, aw * bw))),
        az.neg_mul_add(by, ay.mul_add(bz, ax.mul_add(bw, aw * bx))),
        ax.neg_mul_add(bz, az.mul_add(bx, ay.mul_add(bw, aw * by))),
        ay.neg_mul_add(bx, ax.mul_add(by, az.mul_add(bw, aw * bz))),
    ]
}

/// The quaternion scaled to length one.
#[inline(always)]
pub fn quaternion_normalised<S: Real>(q: &[S; 4]) -> [S; 4] {
    let n2 = q[3].mul_add(q[3], q[2].mul_add(q[2], q[1].mul_add(q[1], q[0] * q[0])));
    let s = n2.sqrt().recip();
    [q[0] * s, q[1] * s, q[2] * s, q[3] * s]
}

/// Quaternion of the rotation by the vector `phi` (rad): the exponential map.
#[inline(always)]
pub fn quaternion_exp<S: Real>(phi: Vec3<S>) -> [S; 4] {
    let half = S::splat(0.5);
    let angle = dot(phi, phi).sqrt();
    let (s, c) = (half * angle).sin_cos();
    // sin(θ/2)/θ → ½ − θ²/48 where the quotient loses its meaning.
    let small = angle.lt(S::splat(1e-4));
    let safe = S::select(small, S::one(), angle);
    let k = S::select(small, (angle * angle).mul_add(S::splat(-1.0 / 48.0), half), s / safe);
    [c, k * phi[0], k * phi[1], k * phi[2]]
}

/// The rotation Rx(a) Ry(b) Rz(c) of the angles (a, b, c) (rad); [`euler_xyz`] takes it apart again.
#[inline(always)]
pub fn euler_xyz_to_rotation<S: Real>(angles: Vec3<S>) -> Mat3<S> {
    let [a, b, c] = angles;
    let [(sa, ca), (sb, cb), (sc, cc)] = [a.sin_cos(), b.sin_cos(), c.sin_cos()];
    let (sa_sb, ca_sb) = (sa * sb, ca * sb);
    [
        [cb * cc, -(cb * sc), sb],
        [sa_sb.mul_add(cc, ca * sc), sa_sb.neg_mul_add(sc, ca * cc), -(sa * cb)],
        [ca_sb.neg_mul_add(cc, sa * sc), ca_sb.mul_add(sc, sa * cc), ca * cb],
    ]
}

/// How `to` is turned against `from`: the axis of the rotation to · fromᵀ, in the axes that both map to, times
/// 2 sin(θ/2) of its angle θ.
///
/// The rotation vector for small angles, and it grows with the angle up to 168°; beyond, where the axis
/// is about to change its sign, it falls to zero.
#[inline(always)]
pub fn rotation_difference<S: Real>(to: &Mat3<S>, from: &Mat3<S>) -> Vec3<S> {
    // Least square of cos(θ/2) that is divided by the root of.
    const LEAST: f64 = 0.01;
    let entry = |i: usize, j: usize| dot(to[i], from[j]);
    let quarter = S::splat(0.25);
    let trace = entry(0, 0) + entry(1, 1) + entry(2, 2);
    let cos2 = trace.mul_add(quarter, quarter).max(S::splat(LEAST));
    // The matrix less its transpose holds 4 sin(θ/2) cos(θ/2) times the axis.
    let k = S::splat(0.5) / cos2.sqrt();
    [
        k * (entry(2, 1) - entry(1, 2)),
        k * (entry(0, 2) - entry(2, 0)),
        k * (entry(1, 0) - entry(0, 1)),
    ]
}

/// Angles (a, b, c) with rotation = Rx(a) Ry(b) Rz(c): intrinsic x-y-z, b in [−π/2, π/2] (rad).
///
/// The convention of `gym`'s robotics environments, in which tasks state orientation errors.
#[inline(always)]
pub fn euler_xyz<S: Real>(rotation: &Mat3<S>) -> Vec3<S> {
    let r = rotation;
    let cos_b = r[2][2].mul_add(r[2][2], r[1][2] * r[1][2]).sqrt();
    [-(r[1][2].atan2(r[2][2])), -((-r[0][2]).atan2(cos_b)), -(r[0][1].atan2(r[0][0]))]
}

#[cfg(test)]
mod tests;
