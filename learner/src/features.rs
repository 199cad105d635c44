//! Loops compiled for the processor at hand.
//!
//! The compiler turns plain loops over slices into vector instructions, if it may use them. [`run_for`] compiles a computation for three sets of
//! processor features and calls the best one that the processor has. Results may differ between the sets in their last bits (fused multiply-add);
//! the promise of equal bits holds for one processor type.

#![expect(
    unsafe_code,
    reason = "calls of functions compiled for detected processor features have no safe form"
)]

/// Which processor features loops use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Features {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Any,
}

impl Features {
    /// The best that this processor has.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let avx512 =
                has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl");
            if avx512 && has!("fma") {
                return Self::Avx512;
            }
            if has!("avx2") && has!("fma") {
                return Self::Avx2;
            }
        }
        Self::Any
    }
}

/// a · b + c, in one rounding where that is fast.
#[inline(always)]
pub(crate) fn mul_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// Runs a computation compiled for `features`.
#[inline(always)]
pub(crate) fn run_for<L: Loop>(features: Features, job: L) {
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,fma")]
    fn avx512<L: Loop>(job: L) {
        job.run::<true>();
    }
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn avx2<L: Loop>(job: L) {
        job.run::<true>();
    }
    match features {
        // SAFETY: the features were detected.
        #[cfg(target_arch = "x86_64")]
        Features::Avx512 => unsafe { avx512(job) },
        // SAFETY: the features were detected.
        #[cfg(target_arch = "x86_64")]
        Features::Avx2 => unsafe { avx2(job) },
        Features::Any => job.run::<false>(),
    }
}

/// A computation with its arguments; `run` must be `#[inline(always)]`, with all that it calls.
pub(crate) trait Loop {
    /// Computes, with fused multiply-adds if `FMA`.
    fn run<const FMA: bool>(self);
}
