//! How passes round what they put.

use crate::number::{BLOCK, Number};

/// How sixteen numbers are rounded.
pub(super) trait Rounding: Copy {
    fn each<T: Number>(self, x: [f32; BLOCK]) -> [T; BLOCK];
}

/// In steps that every processor has.
#[derive(Clone, Copy)]
pub(super) struct Plain;

impl Rounding for Plain {
    #[inline(always)]
    fn each<T: Number>(self, x: [f32; BLOCK]) -> [T; BLOCK] {
        x.map(T::round)
    }
}

/// By an instruction of AVX-512 with bfloat16.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(super) struct Natively(());

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "the processor's own rounding")]
impl Natively {
    /// # Safety
    /// It is only used by code that is compiled for AVX-512 with bfloat16.
    #[inline(always)]
    pub(super) unsafe fn new() -> Self {
        Self(())
    }
}

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "the processor's own rounding")]
impl Rounding for Natively {
    #[inline(always)]
    fn each<T: Number>(self, x: [f32; BLOCK]) -> [T; BLOCK] {
        // SAFETY: who made it promised that.
        unsafe { T::round_each_natively(x) }
    }
}
