//! The choice among the back ends of the lane types.
//!
//! The arithmetic of the types in `avx512` and `avx2` is processor intrinsics behind `#[inline(always)]`: they become single instructions
//! where they are inlined into the functions there that enable the processor features, and [`dispatch_on`] enters those only after asking the processor.
//! The types are named inside such a call alone, so where there is a value of one, or a function for one, this process has found the features: they stay
//! true when either leaves the call.
#![cfg_attr(
    all(target_arch = "x86_64", not(fuzzing)),
    expect(
        unsafe_code,
        reason = "calls of functions compiled for detected processor features have no safe form"
    )
)]

#[cfg(all(not(target_arch = "wasm32"), any(test, not(target_arch = "x86_64"))))]
use super::portable::F32x16Portable;
#[cfg(all(target_arch = "x86_64", not(fuzzing)))]
use super::{avx2, avx512};
#[cfg(all(target_arch = "x86_64", not(fuzzing)))]
use crate::scalar::LANES;
use crate::scalar::LaneFn;

/// Implementation of the lane types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// One register of 512 or 256 bits (AVX-512 F, DQ, VL, BW).
    Avx512,
    /// One register of 256 bits (AVX2, FMA).
    Avx2,
    /// Plain Rust: sixteen numbers, on x86-64 and in WebAssembly one lone number.
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
            // Fuzzed, most of what is compiled would be vectors, which read no bytes from outside.
            Self::Avx512 | Self::Avx2 if cfg!(fuzzing) => false,
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

/// Whether products of pairs are slower here than those of numbers that lie side by side, widened: without the instruction a pair is taken apart for each
/// product, and Intel's processors do a quarter as many of these instructions as fused multiply-adds (measured on family 6, models 167 and 207).
#[cfg(target_arch = "x86_64")]
pub(crate) fn pairs_are_slow() -> bool {
    let has_instruction = std::arch::is_x86_feature_detected!("avx512bf16");
    Backend::detect() == Backend::Avx512 && (is_intel() || !has_instruction)
}

/// Elsewhere pairs lie side by side anyway.
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn pairs_are_slow() -> bool {
    false
}

/// The first register of leaf 0 holds the first letters of the maker's name.
#[cfg(target_arch = "x86_64")]
fn is_intel() -> bool {
    std::arch::x86_64::__cpuid(0).ebx == u32::from_le_bytes(*b"Genu")
}

/// Whether the processor works through a register of 512 bits as fast as through one of 256: only Intel's were measured. Some of AMD's take it in two halves.
#[cfg(target_arch = "x86_64")]
pub(crate) fn registers_are_whole() -> bool {
    Backend::detect() == Backend::Avx512 && is_intel()
}

/// Elsewhere all registers are of one size.
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn registers_are_whole() -> bool {
    false
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
        #[cfg(all(target_arch = "x86_64", not(fuzzing)))]
        Backend::Avx512 => unsafe { avx512::sixteen::call(f) },
        // SAFETY: the processor features were asserted above.
        #[cfg(all(target_arch = "x86_64", not(fuzzing)))]
        Backend::Avx2 => unsafe { avx2::call(f) },
        #[cfg(all(not(target_arch = "wasm32"), any(test, not(target_arch = "x86_64"))))]
        _ => f.call::<F32x16Portable>(),
        // Lanes would be a loop of lone numbers there.
        #[cfg(any(target_arch = "wasm32", all(target_arch = "x86_64", not(test))))]
        _ => f.call::<f32>(),
    }
}

/// [`dispatch_on`] for `n` environments: with eight lanes if those hold them all and the back end has them, which gives the same bits sooner.
///
/// # Panics
/// As [`dispatch_on`].
pub fn dispatch_for<F: LaneFn>(n: usize, backend: Backend, f: F) -> F::Output {
    #[cfg(all(target_arch = "x86_64", not(fuzzing)))]
    if n <= LANES / 2 && backend == Backend::Avx512 && backend.is_available() {
        // SAFETY: the processor features were just found.
        return unsafe { avx512::eight::call(f) };
    }
    #[cfg(any(not(target_arch = "x86_64"), fuzzing))]
    let _ = n; // no back end there has eight lanes
    dispatch_on(backend, f)
}
