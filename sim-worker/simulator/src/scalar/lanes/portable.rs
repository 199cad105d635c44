//! Sixteen `f32` in plain Rust, for processors that are neither x86-64 nor WebAssembly's.
//!
//! In tests they are there on x86-64, too. There each operation is a function that is called, not code that is inlined: sixteen calls of a
//! library's `fmaf` cost far more than one call around them, and inlined they would be most of what compiling the tests takes.

use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use super::operators::{Mask16, derive_operators};
use crate::scalar::bf16::{self, pairs_side_by_side};
use crate::scalar::real::fills_register;
use crate::scalar::single::{self, single_precision_functions};
use crate::scalar::{LANES, Mask, Real, elementary};

/// Sixteen `f32` in plain Rust. Without hardware fused multiply-add they are slow and still right.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub(crate) struct F32x16Portable([f32; LANES]);

impl F32x16Portable {
    #[cfg_attr(all(target_arch = "x86_64", not(target_feature = "fma")), inline(never))]
    #[cfg_attr(not(all(target_arch = "x86_64", not(target_feature = "fma"))), inline(always))]
    fn map(self, f: impl Fn(f32) -> f32) -> Self {
        let mut r = self;
        for x in &mut r.0 {
            *x = f(*x);
        }
        r
    }
    #[cfg_attr(all(target_arch = "x86_64", not(target_feature = "fma")), inline(never))]
    #[cfg_attr(not(all(target_arch = "x86_64", not(target_feature = "fma"))), inline(always))]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut r = self;
        for i in 0..LANES {
            r.0[i] = f(self.0[i], other.0[i]);
        }
        r
    }
    #[cfg_attr(all(target_arch = "x86_64", not(target_feature = "fma")), inline(never))]
    #[cfg_attr(not(all(target_arch = "x86_64", not(target_feature = "fma"))), inline(always))]
    fn compare(self, other: Self, f: impl Fn(f32, f32) -> bool) -> Mask16 {
        let mut m = 0;
        for i in 0..LANES {
            m |= u16::from(f(self.0[i], other.0[i])) << i;
        }
        Mask16(m)
    }
}

impl Add for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}
impl Sub for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}
impl Mul for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}
impl Div for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}
impl Neg for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}
derive_operators!(F32x16Portable);

impl Real for F32x16Portable {
    const LANES: usize = LANES;
    type Mask = Mask16;
    fills_register!();
    pairs_side_by_side!(|x: Self| x.map(bf16::round));

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x as f32; LANES])
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        f64::from(self.0[i])
    }
    #[inline(always)]
    fn set_lane(&mut self, i: usize, x: f64) {
        self.0[i] = x as f32;
    }
    #[cfg_attr(all(target_arch = "x86_64", not(target_feature = "fma")), inline(never))]
    #[cfg_attr(not(all(target_arch = "x86_64", not(target_feature = "fma"))), inline(always))]
    fn mul_add(self, a: Self, b: Self) -> Self {
        let mut r = self;
        for i in 0..LANES {
            r.0[i] = self.0[i].mul_add(a.0[i], b.0[i]);
        }
        r
    }
    #[inline(always)]
    fn neg_mul_add(self, a: Self, b: Self) -> Self {
        (-self).mul_add(a, b)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(f32::sqrt)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.map(f32::abs)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, single::min)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, single::max)
    }
    #[inline(always)]
    fn round(self) -> Self {
        self.map(f32::round_ties_even)
    }
    #[inline(always)]
    fn floor(self) -> Self {
        self.map(f32::floor)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Mask16 {
        self.compare(other, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Mask16 {
        self.compare(other, |a, b| a <= b)
    }
    #[cfg_attr(all(target_arch = "x86_64", not(target_feature = "fma")), inline(never))]
    #[cfg_attr(not(all(target_arch = "x86_64", not(target_feature = "fma"))), inline(always))]
    fn select(m: Mask16, a: Self, b: Self) -> Self {
        let mut r = b;
        for i in 0..LANES {
            if m.lane(i) {
                r.0[i] = a.0[i];
            }
        }
        r
    }
    #[inline(always)]
    fn copy_sign_to(self, magnitude: Self) -> Self {
        self.zip(magnitude, |s, m| m.copysign(s))
    }
    #[inline(always)]
    fn pow2i(self) -> Self {
        self.map(single::pow2i)
    }
    #[inline(always)]
    fn frexp(self) -> (Self, Self) {
        (self.map(|x| single::frexp(x).0), self.map(|x| single::frexp(x).1))
    }
    single_precision_functions!();
}
