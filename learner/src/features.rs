//! Loops compiled for the processor at hand.
//!
//! The compiler turns plain loops over slices into vector instructions, if it may use them. [`run_for`] compiles a computation for four sets of
//! processor features and calls the best one that the processor has. Results may differ between the sets in their last bits (fused multiply-add);
//! the promise of equal bits holds for one processor type.

#![cfg_attr(
    target_arch = "x86_64",
    expect(
        unsafe_code,
        reason = "calls of functions compiled for detected processor features have no safe form"
    )
)]

/// Which processor features loops use. Those that not every processor has come from [`Features::detect`]
/// alone, so that [`run_for`] need not ask again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Features {
    /// AVX-512 with bfloat16.
    #[cfg(target_arch = "x86_64")]
    Avx512Bf16(Detected),
    #[cfg(target_arch = "x86_64")]
    Avx512(Detected),
    #[cfg(target_arch = "x86_64")]
    Avx2(Detected),
    Any,
}

/// That the processor was asked: nobody else can make one.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Detected(());

impl Features {
    /// The best that this processor has.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let avx512 =
                has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl");
            // AVX-512 stands for AVX2 and FMA, too, to the compiler; a virtual machine may leave them out.
            let avx2 = has!("avx2") && has!("fma");
            if avx512 && avx2 {
                let bf16 = has!("avx512bf16");
                let detected = Detected(());
                return if bf16 { Self::Avx512Bf16(detected) } else { Self::Avx512(detected) };
            }
            if avx2 {
                return Self::Avx2(Detected(()));
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
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16,fma")]
    fn avx512_bf16<L: Loop>(job: L) {
        // SAFETY: compiled for it.
        unsafe { job.run_with_bf16() };
    }
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
        // SAFETY: `detect` found the features, or there would be no `Detected`.
        #[cfg(target_arch = "x86_64")]
        Features::Avx512Bf16(Detected(())) => unsafe { avx512_bf16(job) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Features::Avx512(Detected(())) => unsafe { avx512(job) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Features::Avx2(Detected(())) => unsafe { avx2(job) },
        Features::Any => job.run::<false>(),
    }
}

/// A computation with its arguments; `run` must be `#[inline(always)]`, with all that it calls.
pub(crate) trait Loop {
    /// Computes, with fused multiply-adds if `FMA`.
    fn run<const FMA: bool>(self);

    /// The same with the processor's rounding to bfloat16, where a computation has a use for it.
    ///
    /// # Safety
    /// Called from code that is compiled for AVX-512 with bfloat16.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    unsafe fn run_with_bf16(self)
    where
        Self: Sized,
    {
        self.run::<true>();
    }
}
