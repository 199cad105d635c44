//! The traits: a scalar, the truth value of its comparisons, and the computations that are generic over it.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub, SubAssign};

#[cfg(any(test, target_arch = "wasm32"))]
use super::bf16::Sums;
use super::bf16::{Fused, PairProducts, WeightPair};

/// The most lanes of a lane type. Some have eight, and all numbers of lanes divide this one.
pub const LANES: usize = 16;

/// One truth value per lane.
pub trait Mask:
    Copy
    + Debug
    + PartialEq
    + Send
    + Sync
    + 'static
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
    + Not<Output = Self>
{
    /// The same value in every lane.
    fn splat(value: bool) -> Self;
    /// Whether some lane is set.
    fn any(self) -> bool;
    /// Whether every lane is set.
    fn all(self) -> bool;
    /// Value of lane `i`.
    fn lane(self, i: usize) -> bool;
    /// Replaces the value of lane `i`.
    fn set_lane(&mut self, i: usize, value: bool);
}

/// A real number, or several side by side, one per lane.
///
/// Lanes never mix: lane `i` of a result depends on lane `i` of the operands alone, to the bit.
pub trait Real:
    Copy
    + Clone
    + Debug
    + Default
    + PartialEq
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
{
    /// Number of lanes.
    const LANES: usize;

    /// Lane values that a product of matrices sums up in registers at a time: 16 or 8.
    const PRODUCT_SUMS: usize = 16;

    /// Result of comparisons.
    type Mask: Mask;

    /// Lanes of this kind that fill a register of the processor: this type, or one with more.
    type Register: Real;

    /// Two bfloat16 numbers in each lane (see `bf16.rs`).
    type Pair: Copy + Debug + Send + Sync + 'static;

    /// The same value in every lane, rounded to the type's precision.
    fn splat(x: f64) -> Self;
    /// Value of lane `i`, widened exactly.
    fn lane(self, i: usize) -> f64;
    /// Replaces the value of lane `i`, rounded to the type's precision.
    fn set_lane(&mut self, i: usize, x: f64);

    /// `self · a + b` with one rounding.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// [`Real::mul_add`] for inner loops that do little else: inlined also where it is long.
    #[inline(always)]
    fn mul_add_inlined(self, a: Self, b: Self) -> Self {
        self.mul_add(a, b)
    }
    /// `b − self · a` with one rounding.
    fn neg_mul_add(self, a: Self, b: Self) -> Self;
    /// Square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// `self` where `self < other`, else `other` (so a NaN in `self` yields `other`).
    fn min(self, other: Self) -> Self;
    /// `self` where `self > other`, else `other` (so a NaN in `self` yields `other`).
    fn max(self, other: Self) -> Self;
    /// Nearest integer, ties to even.
    fn round(self) -> Self;
    /// Largest integer not above.
    fn floor(self) -> Self;

    /// `self < other`, false where either is NaN.
    fn lt(self, other: Self) -> Self::Mask;
    /// `self ≤ other`, false where either is NaN.
    fn le(self, other: Self) -> Self::Mask;
    /// `self > other`, false where either is NaN.
    #[inline(always)]
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    /// `self ≥ other`, false where either is NaN.
    #[inline(always)]
    fn ge(self, other: Self) -> Self::Mask {
        other.le(self)
    }
    /// `a` where `m` is set, `b` elsewhere.
    fn select(m: Self::Mask, a: Self, b: Self) -> Self;
    /// `magnitude` with the sign of `self`.
    fn copy_sign_to(self, magnitude: Self) -> Self;

    /// Two to the power of `self`, which must hold integers within the exponents of normal numbers.
    fn pow2i(self) -> Self;
    /// Mantissa in [0.5, 1) and exponent of a positive normal number: `self = mantissa · 2^exponent`.
    fn frexp(self) -> (Self, Self);

    /// `self` limited to [lo, hi].
    #[inline(always)]
    fn clamp(self, lo: Self, hi: Self) -> Self {
        self.max(lo).min(hi)
    }
    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }
    /// One.
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
    /// Reciprocal, correctly rounded.
    #[inline(always)]
    fn recip(self) -> Self {
        Self::one() / self
    }

    /// Sine and cosine of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// Angle of the point (x, self), in (−π, π].
    fn atan2(self, x: Self) -> Self;
    /// e to the power of `self`.
    fn exp(self) -> Self;
    /// Natural logarithm; NaN below zero, −∞ at zero.
    fn ln(self) -> Self;
    /// Decimal logarithm; NaN below zero, −∞ at zero.
    fn log10(self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;

    /// A register with `rows[0]`, `rows[stride]` and so on side by side.
    fn join(rows: &[Self], stride: usize) -> Self::Register;
    /// The `i`-th of what was joined.
    fn part(register: Self::Register, i: usize) -> Self;

    /// `self`, rounded to bfloat16.
    fn to_bf16(self) -> Self;
    /// `first` and `second`, rounded to bfloat16.
    fn pair(first: Self, second: Self) -> Self::Pair;
    /// `x.first · w.first + (x.second · w.second + self)`, each product and sum with one rounding, second first.
    ///
    /// `by` is what the [`PairKernel`] around it was given.
    fn add_pair_product<P: PairProducts>(self, x: Self::Pair, w: WeightPair, by: P) -> Self;
    /// Runs `kernel` as [`Real::compiled`] does, with the processor's own products of pairs where it has them.
    #[inline(always)]
    fn compiled_for_pairs<K: PairKernel<Self>>(kernel: K) -> K::Output {
        Self::compiled(WithoutNative(kernel))
    }

    /// Runs `kernel` in a function of its own that is compiled for this type's processor features.
    ///
    /// Large computations go through here: they are compiled once a type, not once a caller.
    #[inline(always)]
    fn compiled<K: Kernel<Self>>(kernel: K) -> K::Output {
        run_apart(kernel)
    }
}

/// A type that fills its register.
macro_rules! fills_register {
    () => {
        type Register = Self;
        #[inline(always)]
        fn join(rows: &[Self], _: usize) -> Self {
            rows[0]
        }
        #[inline(always)]
        fn part(register: Self, _: usize) -> Self {
            register
        }
    };
}
pub(super) use fills_register;

/// A computation in one scalar type, see [`Real::compiled`]. `run` must be `#[inline(always)]`.
pub trait Kernel<S: Real> {
    /// What the computation returns.
    type Output;
    /// Computes.
    fn run(self) -> Self::Output;
}

/// A computation over lanes, to be compiled once per lane type.
///
/// `call` and everything generic it uses must be `#[inline(always)]`.
pub trait LaneFn {
    /// What the computation returns.
    type Output;
    /// Runs the computation with lane type `S`: sixteen lanes or eight.
    fn call<S: Real>(self) -> Self::Output;
}

/// A computation with products of pairs, see [`Real::compiled_for_pairs`]. `run` must be `#[inline(always)]`.
pub trait PairKernel<S: Real> {
    /// What the computation returns.
    type Output;
    /// Computes, by `products`.
    fn run<P: PairProducts>(self, products: P) -> Self::Output;
}

/// A kernel on a processor without products of pairs.
pub(super) struct WithoutNative<K>(pub(super) K);

impl<S: Real, K: PairKernel<S>> Kernel<S> for WithoutNative<K> {
    type Output = K::Output;
    #[inline(always)]
    fn run(self) -> K::Output {
        self.0.run(Fused)
    }
}

/// A kernel on a processor without fused multiply-add.
#[cfg(any(test, target_arch = "wasm32"))]
pub(super) struct BySums<K>(pub(super) K);

#[cfg(any(test, target_arch = "wasm32"))]
impl<S: Real, K: PairKernel<S>> Kernel<S> for BySums<K> {
    type Output = K::Output;
    #[inline(always)]
    fn run(self) -> K::Output {
        self.0.run(Sums)
    }
}

#[inline(never)]
pub(super) fn run_apart<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    kernel.run()
}

/// [`run_apart`] for what nobody waits for when it runs: compiled with less effort, as what is called seldom is.
#[cold]
#[inline(never)]
pub(super) fn run_seldom<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    kernel.run()
}

/// Whether all lanes of `x` are finite.
pub fn is_finite<S: Real>(x: S) -> bool {
    (0..S::LANES).all(|i| x.lane(i).is_finite())
}

impl Mask for bool {
    #[inline(always)]
    fn splat(value: bool) -> Self {
        value
    }
    #[inline(always)]
    fn any(self) -> bool {
        self
    }
    #[inline(always)]
    fn all(self) -> bool {
        self
    }
    #[inline(always)]
    fn lane(self, _: usize) -> bool {
        self
    }
    #[inline(always)]
    fn set_lane(&mut self, _: usize, value: bool) {
        *self = value;
    }
}
