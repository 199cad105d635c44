//! Numbers as activations are kept: f32 and bfloat16.

use crate::features::{Features, Loop, run_for};

/// Numbers that are rounded at once: as many f32 as a register of 512 bits holds.
pub(crate) const BLOCK: usize = 16;

/// A number as activations are kept.
pub(crate) trait Number: Copy {
    /// Widened exactly.
    fn widen(self) -> f32;
    /// Rounded to nearest, ties to even.
    fn round(x: f32) -> Self;

    /// Sixteen of them by the processor's own instruction, if there is one for this kind: numbers below the normal ones become zero there.
    ///
    /// # Safety
    /// Called from code that is compiled for AVX-512 with bfloat16.
    #[cfg(target_arch = "x86_64")]
    #[expect(unsafe_code, reason = "an instruction of detected processor features")]
    #[inline(always)]
    unsafe fn round_each_natively(x: [f32; BLOCK]) -> [Self; BLOCK] {
        x.map(Self::round)
    }
}

impl Number for f32 {
    #[inline(always)]
    fn widen(self) -> f32 {
        self
    }
    #[inline(always)]
    fn round(x: f32) -> Self {
        x
    }
}

/// bfloat16: the upper half of an f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(transparent)]
pub(crate) struct Bf16(pub(crate) u16);

impl Number for Bf16 {
    #[inline(always)]
    fn widen(self) -> f32 {
        f32::from_bits(u32::from(self.0) << 16)
    }
    #[inline(always)]
    fn round(x: f32) -> Self {
        let bits = x.to_bits();
        // Half of the last place, less one if that is even; NaN stays NaN, because libtorch's has its upper bits set.
        Self((bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16) as u16)
    }
    #[cfg(target_arch = "x86_64")]
    #[expect(unsafe_code, reason = "an instruction of detected processor features")]
    #[inline(always)]
    unsafe fn round_each_natively(x: [f32; BLOCK]) -> [Self; BLOCK] {
        use std::arch::x86_64::{_mm512_cvtneps_pbh, _mm512_loadu_ps};
        // SAFETY: the caller's promise. Both types are 32 bytes, of which any bits are sixteen numbers.
        unsafe { std::mem::transmute(_mm512_cvtneps_pbh(_mm512_loadu_ps(x.as_ptr()))) }
    }
}

/// Rounds number by number.
pub(crate) fn round_all(from: &[f32], to: &mut [Bf16]) {
    run_for(Features::detect(), Round { from, to });
}

/// The arguments of [`round_all`].
struct Round<'a> {
    from: &'a [f32],
    to: &'a mut [Bf16],
}

impl Loop for Round<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        for (&from, to) in self.from.iter().zip(self.to) {
            *to = Bf16::round(from);
        }
    }
}
