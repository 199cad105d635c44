//! Whether the processor multiplies bfloat16 in pairs.

/// That it does: nobody but [`Native::detect`] can make one.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Native(());

/// Only processors with AVX-512 do: nobody can make one.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Native {}

impl Native {
    /// Asks the processor. One that has tiles of bfloat16 beside the pairs (AMX) is left to libtorch, which multiplies several times as
    /// fast with them.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn detect() -> Option<Self> {
        use std::arch::is_x86_feature_detected as has;
        let has_pairs = has!("avx512f")
            && has!("avx512bw")
            && has!("avx512dq")
            && has!("avx512vl")
            && has!("avx512bf16");
        (has_pairs && !has_tiles()).then_some(Self(()))
    }

    /// No other processor has them.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn detect() -> Option<Self> {
        None
    }
}

/// Whether the processor has AMX with bfloat16: leaf 7, bit 22 of EDX. AVX-512 is there, so leaf 7 is.
#[cfg(target_arch = "x86_64")]
fn has_tiles() -> bool {
    std::arch::x86_64::__cpuid_count(7, 0).edx >> 22 & 1 == 1
}
