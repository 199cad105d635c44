//! Articulated-body inertia: the symmetric 6 × 6 matrix, kept as its 21 numbers and carried between link frames.
//!
//! Formulas have the letters of the second pass of Featherstone 2008, Table 7.1.

use super::kinematics::twist;
use crate::model::{ArmModel, LinkModel, RigidInertia, Sparsity, Twist};
use crate::scalar::Real;
use crate::spatial::{Mat3, Vec3, Vec6, cross_add, dot, mat_mat, mat_vec};

/// Symmetric 3 × 3 matrix: xx, yy, zz, xy, xz, yz.
pub(crate) type Sym3<S> = [S; 6];

/// [A B; Bᵀ C] with A the angular and C the linear block: moment = A ω̇ + B v̇, force = Bᵀ ω̇ + C v̇.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArticulatedInertia<S> {
    pub(crate) a: Sym3<S>,
    pub(crate) b: Mat3<S>,
    pub(crate) c: Sym3<S>,
}

#[inline(always)]
fn sym_vec<S: Real>(m: Sym3<S>, v: Vec3<S>) -> Vec3<S> {
    let [xx, yy, zz, xy, xz, yz] = m;
    [dot([xx, xy, xz], v), dot([xy, yy, yz], v), dot([xz, yz, zz], v)]
}

/// Rz(q) M Rz(q)ᵀ of a symmetric matrix.
///
/// With e = s (xx − yy) + 2 c xy: xx' = xx − s e, yy' = yy + s e, xy' = c e − xy.
#[inline(always)]
fn turn_sym<S: Real>(s: S, c: S, m: Sym3<S>) -> Sym3<S> {
    let [xx, yy, zz, xy, xz, yz] = m;
    let e = s.mul_add(xx - yy, c * (xy + xy));
    [
        s.neg_mul_add(e, xx),
        s.mul_add(e, yy),
        zz,
        c.mul_add(e, -xy),
        s.neg_mul_add(yz, c * xz),
        s.mul_add(xz, c * yz),
    ]
}

/// Rz(q) M Rz(q)ᵀ of any matrix; the plane's part as in [`turn_sym`], with xy + yx for 2 xy.
#[inline(always)]
fn turn_mat<S: Real>(s: S, c: S, m: &Mat3<S>) -> Mat3<S> {
    let e = s.mul_add(m[0][0] - m[1][1], c * (m[0][1] + m[1][0]));
    [
        [s.neg_mul_add(e, m[0][0]), c.mul_add(e, -m[1][0]), s.neg_mul_add(m[1][2], c * m[0][2])],
        [c.mul_add(e, -m[0][1]), s.mul_add(e, m[1][1]), s.mul_add(m[0][2], c * m[1][2])],
        [s.neg_mul_add(m[2][1], c * m[2][0]), s.mul_add(m[2][0], c * m[2][1]), m[2][2]],
    ]
}

/// Rx(α) M Rx(α)ᵀ of a symmetric matrix.
#[inline(always)]
fn twist_sym<S: Real>(link: &LinkModel<S>, sparsity: Sparsity, m: Sym3<S>) -> Sym3<S> {
    let [xx, yy, zz, xy, xz, yz] = m;
    match sparsity.twist {
        Twist::None => m,
        Twist::Quarter => [xx, zz, yy, -xz, xy, -yz],
        Twist::MinusQuarter => [xx, zz, yy, xz, -xy, -yz],
        Twist::General => {
            // A turn about x is a turn about z of the axes (y, z, x).
            let (c, s) = link.twist_cos_sin;
            let [yy, zz, xx, yz, xy, xz] = turn_sym(s, c, [yy, zz, xx, yz, xy, xz]);
            [xx, yy, zz, xy, xz, yz]
        }
    }
}

/// Rx(α) M Rx(α)ᵀ of any matrix.
#[inline(always)]
fn twist_mat<S: Real>(link: &LinkModel<S>, sparsity: Sparsity, m: &Mat3<S>) -> Mat3<S> {
    // Rows first, then columns.
    let rows = [
        twist(link, sparsity, [m[0][0], m[1][0], m[2][0]]),
        twist(link, sparsity, [m[0][1], m[1][1], m[2][1]]),
        twist(link, sparsity, [m[0][2], m[1][2], m[2][2]]),
    ];
    [
        twist(link, sparsity, [rows[0][0], rows[1][0], rows[2][0]]),
        twist(link, sparsity, [rows[0][1], rows[1][1], rows[2][1]]),
        twist(link, sparsity, [rows[0][2], rows[1][2], rows[2][2]]),
    ]
}

impl<S: Real> ArticulatedInertia<S> {
    /// Zero.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self { a: [S::zero(); 6], b: [[S::zero(); 3]; 3], c: [S::zero(); 6] }
    }

    /// Adds a rigid body in the same frame.
    #[inline(always)]
    pub(crate) fn add_body(&mut self, body: &RigidInertia<S>) {
        for i in 0..6 {
            self.a[i] += body.inertia[i];
        }
        let [x, y, z] = body.h;
        self.b[0][1] -= z;
        self.b[0][2] += y;
        self.b[1][0] += z;
        self.b[1][2] -= x;
        self.b[2][0] -= y;
        self.b[2][1] += x;
        for i in 0..3 {
            self.c[i] += body.mass;
        }
    }

    /// Adds another in the same frame.
    #[inline(always)]
    pub(crate) fn add(&mut self, other: &Self) {
        for i in 0..6 {
            self.a[i] += other.a[i];
            self.c[i] += other.c[i];
        }
        for i in 0..3 {
            for j in 0..3 {
                self.b[i][j] += other.b[i][j];
            }
        }
    }

    /// U = I S of a joint about z: the column of its turn.
    #[inline(always)]
    pub(crate) fn z_column(&self) -> Vec6<S> {
        Vec6 { ang: [self.a[4], self.a[5], self.a[2]], lin: self.b[2] }
    }

    /// I_a = I_A − U D⁻¹ Uᵀ, given U as `u` and 1/D.
    #[inline(always)]
    pub(crate) fn remove(&mut self, u: Vec6<S>, d_inv: S) {
        let n = [u.ang[0] * d_inv, u.ang[1] * d_inv, u.ang[2] * d_inv];
        let f = [u.lin[0] * d_inv, u.lin[1] * d_inv, u.lin[2] * d_inv];
        let places = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        for i in 0..6 {
            let (r, s) = places[i];
            self.a[i] = n[r].neg_mul_add(u.ang[s], self.a[i]);
            self.c[i] = f[r].neg_mul_add(u.lin[s], self.c[i]);
        }
        for r in 0..3 {
            for s in 0..3 {
                self.b[r][s] = n[r].neg_mul_add(u.lin[s], self.b[r][s]);
            }
        }
    }

    /// p + I m for a motion m without z components, as c of a joint about z.
    #[inline(always)]
    pub(crate) fn apply_planar(&self, m: PlanarMotion<S>, p: Vec6<S>) -> Vec6<S> {
        let PlanarMotion { ang: [wx, wy], lin: [vx, vy] } = m;
        let (a, b, c) = (&self.a, &self.b, &self.c);
        let m = [wx, wy, vx, vy];
        Vec6 {
            ang: [
                planar_row([a[0], a[3], b[0][0], b[0][1]], m, p.ang[0]),
                planar_row([a[3], a[1], b[1][0], b[1][1]], m, p.ang[1]),
                planar_row([a[4], a[5], b[2][0], b[2][1]], m, p.ang[2]),
            ],
            lin: [
                planar_row([b[0][0], b[1][0], c[0], c[3]], m, p.lin[0]),
                planar_row([b[0][1], b[1][1], c[3], c[1]], m, p.lin[1]),
                planar_row([b[0][2], b[1][2], c[4], c[5]], m, p.lin[2]),
            ],
        }
    }

    /// λX_i* I iX_λ, its turn: seen in axes turned back by the joint about z.
    #[inline(always)]
    pub(crate) fn turned(&self, sin: S, cos: S) -> Self {
        Self {
            a: turn_sym(sin, cos, self.a),
            b: turn_mat(sin, cos, &self.b),
            c: turn_sym(sin, cos, self.c),
        }
    }

    /// λX_i* I iX_λ, its constant step: seen from the link frame before: twist back, then shift the reference point by (a, 0, d).
    ///
    /// With p the shift: B' = B + [p] C, A' = A + [p] Bᵀ + B' [p]ᵀ.
    #[inline(always)]
    pub(crate) fn moved_to_previous(&self, link: &LinkModel<S>, sparsity: Sparsity) -> Self {
        let mut a = twist_sym(link, sparsity, self.a);
        let mut b = twist_mat(link, sparsity, &self.b);
        let c = twist_sym(link, sparsity, self.c);
        let [c_xx, c_yy, c_zz, c_xy, c_xz, c_yz] = c;
        if sparsity.has_a {
            let s = link.a;
            a[1] = s.neg_mul_add(b[1][2], a[1]);
            a[2] = s.mul_add(b[2][1], a[2]);
            a[5] = s.neg_mul_add(b[2][2], a[5]);
            b[1] = [
                s.neg_mul_add(c_xz, b[1][0]),
                s.neg_mul_add(c_yz, b[1][1]),
                s.neg_mul_add(c_zz, b[1][2]),
            ];
            b[2] = [s.mul_add(c_xy, b[2][0]), s.mul_add(c_yy, b[2][1]), s.mul_add(c_yz, b[2][2])];
            a[1] = s.neg_mul_add(b[1][2], a[1]);
            a[2] = s.mul_add(b[2][1], a[2]);
            a[3] = s.neg_mul_add(b[0][2], a[3]);
            a[4] = s.mul_add(b[0][1], a[4]);
            a[5] = s.mul_add(b[1][1], a[5]);
        }
        if sparsity.has_d {
            let s = link.d;
            a[0] = s.neg_mul_add(b[0][1], a[0]);
            a[1] = s.mul_add(b[1][0], a[1]);
            a[3] = s.neg_mul_add(b[1][1], a[3]);
            a[4] = s.neg_mul_add(b[2][1], a[4]);
            a[5] = s.mul_add(b[2][0], a[5]);
            b[0] = [
                s.neg_mul_add(c_xy, b[0][0]),
                s.neg_mul_add(c_yy, b[0][1]),
                s.neg_mul_add(c_yz, b[0][2]),
            ];
            b[1] = [s.mul_add(c_xx, b[1][0]), s.mul_add(c_xy, b[1][1]), s.mul_add(c_xz, b[1][2])];
            a[0] = s.neg_mul_add(b[0][1], a[0]);
            a[1] = s.mul_add(b[1][0], a[1]);
            a[3] = s.mul_add(b[0][0], a[3]);
        }
        Self { a, b, c }
    }

    /// Seen from the base: rotated by the mount's pose, reference point shifted by its position.
    #[inline(always)]
    pub(crate) fn moved_to_base(&self, arm: &ArmModel<S>) -> Self {
        let (mut a, mut b, c);
        if let Some(p) = &arm.permutation {
            a = permute_sym(p.place, p.sign, &self.a);
            c = permute_sym(p.place, p.sign, &self.c);
            b = self.b;
            for i in 0..3 {
                for j in 0..3 {
                    b[i][j] = p.sign[i] * p.sign[j] * self.b[p.place[i]][p.place[j]];
                }
            }
        } else {
            let r = &arm.rotation;
            a = rotate_sym(r, self.a);
            c = rotate_sym(r, self.c);
            let rb = mat_mat(r, &self.b);
            b = [mat_vec(r, rb[0]), mat_vec(r, rb[1]), mat_vec(r, rb[2])];
        }
        // With bⱼ row j of B, column j of [p] Bᵀ is p × bⱼ; B' = B + [p] C, column by column.
        let p = arm.position;
        let [xx, yy, zz, xy, xz, yz] = c;
        let old = b;
        let columns = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        for j in 0..3 {
            let [x, y, z] = cross_add(p, columns[j], [b[0][j], b[1][j], b[2][j]]);
            b[0][j] = x;
            b[1][j] = y;
            b[2][j] = z;
        }
        let zero = [S::zero(); 3];
        let first =
            [cross_add(p, old[0], zero), cross_add(p, old[1], zero), cross_add(p, old[2], zero)];
        let second = [cross_add(p, b[0], zero), cross_add(p, b[1], zero), cross_add(p, b[2], zero)];
        let places = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        for k in 0..6 {
            let (i, j) = places[k];
            a[k] += first[j][i] + second[i][j];
        }
        Self { a, b, c }
    }

    /// The motion m with I m = f.
    ///
    /// By blocks: v̇ = C⁻¹ (force − Bᵀ ω̇), (A − B C⁻¹ Bᵀ) ω̇ = moment − B C⁻¹ force.
    #[inline(always)]
    pub(crate) fn solve(&self, f: Vec6<S>) -> Vec6<S> {
        let c_inv = inverse_sym(self.c);
        let bc = [sym_vec(c_inv, self.b[0]), sym_vec(c_inv, self.b[1]), sym_vec(c_inv, self.b[2])];
        let places = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        let mut schur = self.a;
        for k in 0..6 {
            let (i, j) = places[k];
            schur[k] -= dot(bc[i], self.b[j]);
        }
        let right = mat_vec(&bc, f.lin);
        let moment = [f.ang[0] - right[0], f.ang[1] - right[1], f.ang[2] - right[2]];
        let ang = sym_vec(inverse_sym(schur), moment);
        let free = sym_vec(c_inv, f.lin);
        // C⁻¹ Bᵀ ω̇ = (B C⁻¹)ᵀ ω̇.
        let lin = [
            free[0] - bc[2][0].mul_add(ang[2], bc[1][0].mul_add(ang[1], bc[0][0] * ang[0])),
            free[1] - bc[2][1].mul_add(ang[2], bc[1][1].mul_add(ang[1], bc[0][1] * ang[0])),
            free[2] - bc[2][2].mul_add(ang[2], bc[1][2].mul_add(ang[1], bc[0][2] * ang[0])),
        ];
        Vec6 { ang, lin }
    }
}

#[inline(always)]
fn planar_row<S: Real>(row: [S; 4], m: [S; 4], p: S) -> S {
    row[0].mul_add(m[0], row[1].mul_add(m[1], row[2].mul_add(m[2], row[3].mul_add(m[3], p))))
}

/// Velocity product of a joint about z: v × S q̇ has no z components.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlanarMotion<S> {
    pub(crate) ang: [S; 2],
    pub(crate) lin: [S; 2],
}

#[inline(always)]
fn permute_sym<S: Real>(place: [usize; 3], sign: [S; 3], m: &Sym3<S>) -> Sym3<S> {
    // Where the element (i, j) stands.
    const AT: [[usize; 3]; 3] = [[0, 3, 4], [3, 1, 5], [4, 5, 2]];
    let [x, y, z] = place;
    [
        m[x],
        m[y],
        m[z],
        sign[0] * sign[1] * m[AT[x][y]],
        sign[0] * sign[2] * m[AT[x][z]],
        sign[1] * sign[2] * m[AT[y][z]],
    ]
}

/// R M Rᵀ of a symmetric matrix.
#[inline(always)]
fn rotate_sym<S: Real>(r: &Mat3<S>, m: Sym3<S>) -> Sym3<S> {
    let rm = [sym_vec(m, r[0]), sym_vec(m, r[1]), sym_vec(m, r[2])];
    [
        dot(rm[0], r[0]),
        dot(rm[1], r[1]),
        dot(rm[2], r[2]),
        dot(rm[0], r[1]),
        dot(rm[0], r[2]),
        dot(rm[1], r[2]),
    ]
}

/// Inverse of a symmetric positive definite matrix, by cofactors.
#[inline(always)]
fn inverse_sym<S: Real>(m: Sym3<S>) -> Sym3<S> {
    let [xx, yy, zz, xy, xz, yz] = m;
    let c_xx = yz.neg_mul_add(yz, yy * zz);
    let c_xy = xy.neg_mul_add(zz, xz * yz);
    let c_xz = xz.neg_mul_add(yy, xy * yz);
    let det = xz.mul_add(c_xz, xy.mul_add(c_xy, xx * c_xx));
    let s = det.recip();
    [
        s * c_xx,
        s * xz.neg_mul_add(xz, xx * zz),
        s * xy.neg_mul_add(xy, xx * yy),
        s * c_xy,
        s * c_xz,
        s * yz.neg_mul_add(xx, xy * xz),
    ]
}
