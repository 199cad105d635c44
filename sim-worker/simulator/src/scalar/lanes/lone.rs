//! Lone scalars: their kernels, compiled with fused multiply-add where the processor has it.
#![cfg_attr(
    target_arch = "x86_64",
    expect(
        unsafe_code,
        reason = "calls of functions compiled for detected processor features have no safe form"
    )
)]

#[cfg(not(target_arch = "x86_64"))]
use crate::scalar::real::run_apart;
#[cfg(target_arch = "x86_64")]
use crate::scalar::real::run_seldom;
use crate::scalar::{Kernel, Real};

/// Runs a kernel of a lone scalar with the processor's fused multiply-add where it has one: the same bits as without, much faster.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(crate) fn run_scalar<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the processor features were just found.
        return unsafe { run_fma(kernel) };
    }
    // A processor of before 2013, say. Each multiply-add is a call there, however well the rest is compiled.
    run_seldom(kernel)
}

/// Runs a kernel of a lone scalar. These processors have a fused multiply-add, or `single.rs` has one for them.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
pub(crate) fn run_scalar<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    run_apart(kernel)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn run_fma<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    kernel.run()
}
