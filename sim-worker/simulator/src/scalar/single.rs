//! Lone `f32`: the same bits as one lane of the lane types.

use super::bf16::{self, pairs_side_by_side};
#[cfg(target_arch = "wasm32")]
use super::fused::mul_add as fused;
use super::real::fills_register;
use super::{Kernel, Real, elementary, lanes};
#[cfg(target_arch = "wasm32")]
use super::{PairKernel, real::BySums};

/// `x · y + z` with one rounding.
#[cfg(not(target_arch = "wasm32"))]
#[inline(always)]
fn fused(x: f32, y: f32, z: f32) -> f32 {
    x.mul_add(y, z)
}

/// `a < b ? a : b`, as the processors' vector minimum.
#[inline(always)]
pub(super) fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `a > b ? a : b`, as the processors' vector maximum.
#[inline(always)]
pub(super) fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// 2^k for an integer-valued k within the normal exponents.
#[inline(always)]
pub(super) fn pow2i(k: f32) -> f32 {
    f32::from_bits(((k as i32 + 127) as u32) << 23)
}

/// Mantissa in [0.5, 1) and exponent of a positive normal number.
#[inline(always)]
pub(super) fn frexp(x: f32) -> (f32, f32) {
    let bits = x.to_bits();
    let exponent = ((bits >> 23) & 0xff) as i32 - 126;
    (f32::from_bits((bits & 0x807f_ffff) | 0x3f00_0000), exponent as f32)
}

/// The elementary functions shared by every single-precision type.
macro_rules! single_precision_functions {
    () => {
        #[inline(always)]
        fn sin_cos(self) -> (Self, Self) {
            elementary::sin_cos(self)
        }
        #[inline(always)]
        fn atan2(self, x: Self) -> Self {
            elementary::atan2(self, x)
        }
        #[inline(always)]
        fn exp(self) -> Self {
            elementary::exp(self)
        }
        #[inline(always)]
        fn ln(self) -> Self {
            elementary::ln(self)
        }
        #[inline(always)]
        fn log10(self) -> Self {
            elementary::log10(self)
        }
        #[inline(always)]
        fn tanh(self) -> Self {
            elementary::tanh(self)
        }
    };
}
#[cfg(not(target_arch = "wasm32"))]
pub(super) use single_precision_functions;

impl Real for f32 {
    const LANES: usize = 1;
    type Mask = bool;
    fills_register!();
    pairs_side_by_side!(bf16::round);

    #[inline(always)]
    fn splat(x: f64) -> Self {
        x as f32
    }
    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn set_lane(&mut self, _: usize, x: f64) {
        *self = x as f32;
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        fused(self, a, b)
    }
    #[cfg(target_arch = "wasm32")]
    #[inline(always)]
    fn mul_add_inlined(self, a: Self, b: Self) -> Self {
        super::fused::inlined(self, a, b)
    }
    #[inline(always)]
    fn neg_mul_add(self, a: Self, b: Self) -> Self {
        fused(-self, a, b)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f32::abs(self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        min(self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        max(self, other)
    }
    #[inline(always)]
    fn round(self) -> Self {
        self.round_ties_even()
    }
    #[inline(always)]
    fn floor(self) -> Self {
        f32::floor(self)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn le(self, other: Self) -> bool {
        self <= other
    }
    #[inline(always)]
    fn select(m: bool, a: Self, b: Self) -> Self {
        if m { a } else { b }
    }
    #[inline(always)]
    fn copy_sign_to(self, magnitude: Self) -> Self {
        magnitude.copysign(self)
    }
    #[inline(always)]
    fn pow2i(self) -> Self {
        pow2i(self)
    }
    #[inline(always)]
    fn frexp(self) -> (Self, Self) {
        frexp(self)
    }
    #[inline(always)]
    fn compiled<K: Kernel<Self>>(kernel: K) -> K::Output {
        lanes::run_scalar(kernel)
    }
    #[cfg(target_arch = "wasm32")]
    #[inline(always)]
    fn compiled_for_pairs<K: PairKernel<Self>>(kernel: K) -> K::Output {
        Self::compiled(BySums(kernel))
    }
    single_precision_functions!();
}
