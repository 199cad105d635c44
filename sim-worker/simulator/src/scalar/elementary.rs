//! Elementary functions in single precision, written once for lone `f32` and for lanes.
//!
//! Only IEEE operations with one rounding are used, in a fixed order, so that every back end gives the same bits. The polynomials are the
//! minimax ones of the Cephes library's single-precision functions (Moshier, netlib `cephes/single`); reductions use fused
//! multiply-adds where Cephes splits constants, which makes them exact over a wider range. Accuracies in the docs are the largest
//! error seen against `f64` over a dense sample (see the tests).

use super::Real;

/// Σ c_i x^i, highest power first (Horner).
#[inline(always)]
fn horner<S: Real, const N: usize>(x: S, coefficients: [f64; N]) -> S {
    let mut y = S::splat(coefficients[0]);
    let mut i = 1;
    while i < N {
        y = y.mul_add(x, S::splat(coefficients[i]));
        i += 1;
    }
    y
}

/// Sine and cosine; for |x| ≤ 1000 rad at most 2 ulp of the larger of the result and 0.01.
#[inline(always)]
pub fn sin_cos<S: Real>(x: S) -> (S, S) {
    // x = j·π/2 + r, |r| ≤ π/4; π/2 in two f32 parts, so that the two fused products lose nothing down to 1e-15·j.
    let j = (x * S::splat(std::f64::consts::FRAC_2_PI)).round();
    let r = j.neg_mul_add(S::splat(1.570_796_370_506_286_6), x);
    let r = j.neg_mul_add(S::splat(-4.371_139_000_186_241e-8), r);
    let z = r * r;
    let s = horner(z, [-1.951_529_589_1e-4, 8.332_160_873_6e-3, -1.666_665_461_1e-1]);
    let s = (z * r).mul_add(s, r);
    let c =
        horner(z, [2.443_315_711_809_948e-5, -1.388_731_625_493_765e-3, 4.166_664_568_298_827e-2]);
    let c = (z * z).mul_add(c, z.mul_add(S::splat(-0.5), S::one()));
    // Quadrant 0…3: odd ones swap, 2 and 3 negate the sine, 1 and 2 the cosine.
    let quadrant = (j * S::splat(0.25)).floor().mul_add(S::splat(-4.0), j);
    let is_1 = quadrant.ge(S::splat(0.5)) & quadrant.lt(S::splat(1.5));
    let upper = quadrant.ge(S::splat(1.5));
    let is_3 = quadrant.ge(S::splat(2.5));
    let swap = is_1 | is_3;
    let sin = S::select(swap, c, s);
    let cos = S::select(swap, s, c);
    let negate_cos = is_1 | (upper & !is_3);
    (S::select(upper, -sin, sin), S::select(negate_cos, -cos, cos))
}

/// Angle of the point (x, y) in (−π, π]; at most 3 ulp. Zero at the origin.
#[inline(always)]
pub fn atan2<S: Real>(y: S, x: S) -> S {
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ay.gt(ax);
    let hi = S::select(steep, ay, ax);
    let lo = S::select(steep, ax, ay);
    // atan(lo/hi) in [0, π/4]; above tan(π/8) as π/4 + atan((lo − hi)/(lo + hi)).
    let big = lo.gt(hi * S::splat(0.414_213_562_373_095_05));
    let numerator = S::select(big, lo - hi, lo);
    let denominator = S::select(big, lo + hi, hi);
    let safe = S::select(denominator.gt(S::zero()), denominator, S::one());
    let t = numerator / safe;
    let z = t * t;
    let p = horner(
        z,
        [8.053_744_495_38e-2, -1.387_768_560_32e-1, 1.997_771_064_78e-1, -3.333_294_911_39e-1],
    );
    let a = (p * z).mul_add(t, t);
    let a = S::select(big, a + S::splat(std::f64::consts::FRAC_PI_4), a);
    let a = S::select(steep, S::splat(std::f64::consts::FRAC_PI_2) - a, a);
    let a = S::select(x.lt(S::zero()), S::splat(std::f64::consts::PI) - a, a);
    y.copy_sign_to(a)
}

/// e^x; at most 2 ulp; 0 below −104, ∞ above 88.73.
#[inline(always)]
pub fn exp<S: Real>(x: S) -> S {
    let (n, y) = exp_reduced(x.clamp(S::splat(-104.0), S::splat(89.0)));
    // Two factors, because 2^n alone leaves the normal numbers at both ends.
    let n1 = (n * S::splat(0.5)).floor();
    let y = (y * n1.pow2i()) * (n - n1).pow2i();
    let y = S::select(x.gt(S::splat(88.73)), S::splat(f64::INFINITY), y);
    // The clamp turned NaN into a number: give it back.
    S::select(x.le(S::splat(f64::INFINITY)), y, x)
}

/// (n, y) with e^x = y · 2^n, n whole and y from √½ to √2.
#[inline(always)]
fn exp_reduced<S: Real>(x: S) -> (S, S) {
    let n = (x * S::splat(std::f64::consts::LOG2_E)).round();
    let r = n.neg_mul_add(S::splat(0.693_359_375), x);
    let r = n.neg_mul_add(S::splat(-2.121_944_4e-4), r);
    let p = horner(
        r,
        [
            1.987_569_15e-4,
            1.398_199_95e-3,
            8.333_451_9e-3,
            4.166_579_6e-2,
            1.666_666_55e-1,
            5.000_000_1e-1,
        ],
    );
    (n, p.mul_add(r * r, r + S::one()))
}

/// e^x for x ≤ 0 in half as many operations: the bits of [`exp`] down to −87, and below that, and for NaN, e^−87.
#[inline(always)]
pub fn exp_of_negative<S: Real>(x: S) -> S {
    let c = x.max(S::splat(-87.0));
    let (n, y) = exp_reduced(c);
    // A normal number and so are both factors: none of this rounds.
    y * n.pow2i()
}

/// Natural logarithm; at most 2 ulp; NaN below zero, −∞ at zero.
#[inline(always)]
pub fn ln<S: Real>(x: S) -> S {
    let (mantissa, e) = log_reduce(x);
    let f = mantissa;
    let y = e.mul_add(S::splat(-2.121_944_4e-4), log_series(f));
    let y = f + y;
    let y = e.mul_add(S::splat(0.693_359_375), y);
    log_edges(x, y)
}

/// Decimal logarithm; at most 3 ulp; NaN below zero, −∞ at zero.
#[inline(always)]
pub fn log10<S: Real>(x: S) -> S {
    let (f, e) = log_reduce(x);
    let rest = log_series(f);
    // log10(e) and log10(2) split so that the leading products are exact.
    let y = (f + rest) * S::splat(7.007_315_1e-4);
    let y = e.mul_add(S::splat(2.487_455_663e-4), y);
    let y = rest.mul_add(S::splat(4.335_937_5e-1), y);
    let y = f.mul_add(S::splat(4.335_937_5e-1), y);
    let y = e.mul_add(S::splat(3.007_812_5e-1), y);
    log_edges(x, y)
}

/// x = (1 + f) · 2^e with 1 + f in [√½, √2).
#[inline(always)]
fn log_reduce<S: Real>(x: S) -> (S, S) {
    let tiny = x.lt(S::splat(f64::from(f32::MIN_POSITIVE)));
    let scaled = S::select(tiny, x * S::splat(16_777_216.0), x);
    let (m, e) = scaled.frexp();
    let e = S::select(tiny, e - S::splat(24.0), e);
    let low = m.lt(S::splat(std::f64::consts::FRAC_1_SQRT_2));
    let e = S::select(low, e - S::one(), e);
    let m = S::select(low, m + m, m);
    (m - S::one(), e)
}

/// ln(1 + f) − f.
#[inline(always)]
fn log_series<S: Real>(f: S) -> S {
    let z = f * f;
    let p = horner(
        f,
        [
            7.037_683_6e-2,
            -1.151_461_03e-1,
            1.167_699_87e-1,
            -1.242_014_08e-1,
            1.424_932_28e-1,
            -1.666_805_77e-1,
            2.000_071_48e-1,
            -2.499_999_4e-1,
            3.333_333_12e-1,
        ],
    );
    z.mul_add(S::splat(-0.5), p * f * z)
}

/// The values of a logarithm at and below zero, at infinity and at NaN.
#[inline(always)]
fn log_edges<S: Real>(x: S, y: S) -> S {
    let y = S::select(x.lt(S::splat(f64::INFINITY)), y, x);
    let y = S::select(x.lt(S::zero()), S::splat(f64::NAN), y);
    S::select(x.le(S::zero()) & x.ge(S::zero()), S::splat(f64::NEG_INFINITY), y)
}

/// Hyperbolic tangent; at most 2 ulp.
#[inline(always)]
pub fn tanh<S: Real>(x: S) -> S {
    let a = x.abs();
    let z = x * x;
    let p = horner(
        z,
        [-5.704_988_73e-3, 2.063_908_88e-2, -5.373_971_53e-2, 1.333_144_21e-1, -3.333_328_19e-1],
    );
    let small = (p * z).mul_add(x, x);
    let e = exp(a + a);
    let large = S::one() - S::splat(2.0) / (e + S::one());
    S::select(a.lt(S::splat(0.625)), small, x.copy_sign_to(large))
}
