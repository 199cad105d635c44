//! Several `f32` side by side, in back ends of the same bits, and the choice among them.
//!
//! The arithmetic of the types in `avx512` and `avx2` is processor intrinsics behind `#[inline(always)]`: they become single instructions
//! where they are inlined into the functions there that enable the processor features, and [`dispatch_on`] enters those only after asking the processor.
//! The types are named inside such a call alone, so where there is a value of one, or a function for one, this process has found the features: they stay
//! true when either leaves the call.
#![cfg_attr(
    target_arch = "x86_64",
    expect(
        unsafe_code,
        reason = "calls of functions compiled for detected processor features have no safe form"
    )
)]

use std::ops::{BitAnd, BitOr, Not};

#[cfg(target_arch = "x86_64")]
use super::LANES;
use super::{Kernel, Mask, Real};

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;

use portable::F32x16Portable;

/// A computation over lanes, to be compiled once per lane type.
///
/// `call` and everything generic it uses must be `#[inline(always)]`.
pub trait LaneFn {
    /// What the computation returns.
    type Output;
    /// Runs the computation with lane type `S`: sixteen lanes, or eight if [`dispatch_for`] chose so.
    fn call<S: Real>(self) -> Self::Output;
}

/// Implementation of the lane types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// One register of 512 or 256 bits (AVX-512 F, DQ, VL, BW).
    Avx512,
    /// Two 256-bit registers (AVX2, FMA).
    Avx2,
    /// Plain Rust.
    Portable,
}

impl Backend {
    /// The fastest back end of this processor.
    pub fn detect() -> Self {
        *[Self::Avx512, Self::Avx2].iter().find(|b| b.is_available()).unwrap_or(&Self::Portable)
    }

    /// Whether this processor can run the back end.
    pub fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                // The compiler takes AVX2 for granted with AVX-512; a virtual machine may leave it out.
                Self::Avx2.is_available()
                    && std::arch::is_x86_feature_detected!("avx512f")
                    && std::arch::is_x86_feature_detected!("avx512dq")
                    && std::arch::is_x86_feature_detected!("avx512vl")
                    && std::arch::is_x86_feature_detected!("avx512bw")
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                std::arch::is_x86_feature_detected!("avx2")
                    && std::arch::is_x86_feature_detected!("fma")
            }
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx512 | Self::Avx2 => false,
            Self::Portable => true,
        }
    }
}

/// Runs `f` with the fastest back end of this processor.
pub fn dispatch<F: LaneFn>(f: F) -> F::Output {
    dispatch_on(Backend::detect(), f)
}

/// Runs `f` with a chosen back end.
///
/// # Panics
/// If this processor cannot run it (see [`Backend::is_available`]).
pub fn dispatch_on<F: LaneFn>(backend: Backend, f: F) -> F::Output {
    assert!(backend.is_available(), "this processor cannot run {backend:?}");
    match backend {
        // SAFETY: the processor features were asserted above.
        #[cfg(target_arch = "x86_64")]
        Backend::Avx512 => unsafe { avx512::sixteen::call(f) },
        // SAFETY: the processor features were asserted above.
        #[cfg(target_arch = "x86_64")]
        Backend::Avx2 => unsafe { avx2::call(f) },
        _ => f.call::<F32x16Portable>(),
    }
}

/// [`dispatch_on`] for `n` environments: with eight lanes if those hold them all and the back end has them, which gives the same bits sooner.
///
/// # Panics
/// As [`dispatch_on`].
pub fn dispatch_for<F: LaneFn>(n: usize, backend: Backend, f: F) -> F::Output {
    #[cfg(target_arch = "x86_64")]
    if n <= LANES / 2 && backend == Backend::Avx512 && backend.is_available() {
        // SAFETY: the processor features were just found.
        return unsafe { avx512::eight::call(f) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = n; // no back end there has eight lanes
    dispatch_on(backend, f)
}

/// Runs a kernel of a lone scalar with the processor's fused multiply-add where it has one: the same bits as without, much faster.
#[inline(always)]
pub(super) fn run_scalar<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the processor features were just found.
        return unsafe { run_fma(kernel) };
    }
    super::run_apart(kernel)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn run_fma<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    kernel.run()
}

/// A mask with a bit per lane.
macro_rules! bit_mask {
    ($mask:ident, $bits:ident) => {
        /// One bit per lane.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) struct $mask($bits);

        impl BitAnd for $mask {
            type Output = Self;
            #[inline(always)]
            fn bitand(self, other: Self) -> Self {
                Self(self.0 & other.0)
            }
        }
        impl BitOr for $mask {
            type Output = Self;
            #[inline(always)]
            fn bitor(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }
        }
        impl Not for $mask {
            type Output = Self;
            #[inline(always)]
            fn not(self) -> Self {
                Self(!self.0)
            }
        }
        impl Mask for $mask {
            #[inline(always)]
            fn splat(value: bool) -> Self {
                Self(if value { $bits::MAX } else { 0 })
            }
            #[inline(always)]
            fn any(self) -> bool {
                self.0 != 0
            }
            #[inline(always)]
            fn all(self) -> bool {
                self.0 == $bits::MAX
            }
            #[inline(always)]
            fn lane(self, i: usize) -> bool {
                self.0 >> i & 1 == 1
            }
            #[inline(always)]
            fn set_lane(&mut self, i: usize, value: bool) {
                self.0 = self.0 & !(1 << i) | $bits::from(value) << i;
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
use bit_mask;

bit_mask!(Mask16, u16);

/// The parts of [`Real`] and of its supertraits that follow from a type's few basic operations.
macro_rules! derive_operators {
    ($t:ident) => {
        impl Default for $t {
            #[inline(always)]
            fn default() -> Self {
                Self::splat(0.0)
            }
        }
        impl AddAssign for $t {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
        impl SubAssign for $t {
            #[inline(always)]
            fn sub_assign(&mut self, other: Self) {
                *self = *self - other;
            }
        }
        impl MulAssign for $t {
            #[inline(always)]
            fn mul_assign(&mut self, other: Self) {
                *self = *self * other;
            }
        }
    };
}

use derive_operators;

/// A binary operator of an intrinsic type.
#[cfg(target_arch = "x86_64")]
macro_rules! operator {
    ($t:ident, $trait:ident, $f:ident, |$a:ident, $b:ident| $e:expr) => {
        impl $trait for $t {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                // SAFETY: values of this type exist only once `dispatch_on` or `dispatch_for` has found the processor features.
                unsafe { $e }
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
use operator;
