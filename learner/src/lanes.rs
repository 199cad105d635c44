//! Numbers that are computed side by side: one, or those of several registers.
//!
//! A formula for [`Lanes`] is written once, for the readable twin and for the fast path. Registers take each step of it in turns: while one waits for
//! its last step, others take theirs.

use crate::features::mul_add;

/// Numbers side by side.
pub(crate) trait Lanes: Copy {
    /// That the processor can compute them.
    type Can: Copy;

    /// The same number in all places. Made once and kept in registers; a literal would be loaded from memory for each row.
    fn constant(can: Self::Can, x: f32) -> Self;
    fn plus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    /// self · b + c, in one rounding if `FMA`.
    fn mul_add<const FMA: bool>(self, b: Self, c: Self) -> Self;
    /// The bound where the number is below it. NaN stays.
    fn at_least(self, bound: Self) -> Self;
    /// `then` where the number is positive, `otherwise` elsewhere.
    fn if_positive(self, then: Self, otherwise: Self) -> Self;
    /// self · 2ⁿ, if that is a normal number and −126 ≤ n ≤ 0. `n` is whole, and `sum` is its sum with [`ROUND`]: registers read the first,
    /// one number the second.
    fn times_power_of_two(self, n: Self, sum: Self) -> Self;
}

/// 1.5 · 2²³: sums with it have no digits behind the point, and a whole number stands in their lower bits.
pub(crate) const ROUND: f32 = 12_582_912.0;

impl Lanes for f32 {
    type Can = ();

    #[inline(always)]
    fn constant((): (), x: f32) -> Self {
        x
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self + other
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self * other
    }
    #[inline(always)]
    fn mul_add<const FMA: bool>(self, b: Self, c: Self) -> Self {
        mul_add::<FMA>(self, b, c)
    }
    #[inline(always)]
    fn at_least(self, bound: Self) -> Self {
        if self < bound { bound } else { self }
    }
    #[inline(always)]
    fn if_positive(self, then: Self, otherwise: Self) -> Self {
        if self > 0.0 { then } else { otherwise }
    }
    #[inline(always)]
    fn times_power_of_two(self, _: Self, sum: Self) -> Self {
        let exponent = sum.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127);
        self * f32::from_bits(exponent << 23)
    }
}

/// That the code at hand is compiled for AVX-512.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(crate) struct Avx512(());

/// The numbers of V registers of 512 bits.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(crate) struct Registers<const V: usize>([std::arch::x86_64::__m512; V]);

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "instructions of detected processor features")]
mod registers {
    use std::arch::asm;
    use std::arch::x86_64::{
        __m512, _CMP_GT_OQ, _mm512_add_ps, _mm512_cmp_ps_mask, _mm512_fmadd_ps, _mm512_mask_mov_ps,
        _mm512_max_ps, _mm512_mul_ps, _mm512_scalef_ps, _mm512_set1_ps, _mm512_setzero_ps,
    };

    use super::{Avx512, Lanes, Registers};

    impl Avx512 {
        /// # Safety
        /// It is only used by code that is compiled for AVX-512.
        #[inline(always)]
        pub(crate) unsafe fn new() -> Self {
            Self(())
        }
    }

    impl<const V: usize> Registers<V> {
        #[inline(always)]
        pub(crate) fn new(_: Avx512, registers: [__m512; V]) -> Self {
            Self(registers)
        }

        #[inline(always)]
        pub(crate) fn get(self) -> [__m512; V] {
            self.0
        }
    }

    /// A number in all places of a register. Nothing happens in the assembly, but the compiler does not know that.
    #[target_feature(enable = "avx512f")]
    #[inline]
    fn kept(x: f32) -> __m512 {
        let mut register = _mm512_set1_ps(x);
        // SAFETY: it does nothing.
        unsafe {
            asm!("/* {} */", inout(zmm_reg) register, options(pure, nomem, nostack, preserves_flags));
        }
        register
    }

    // No closures: they would be compiled without the features of their caller.
    macro_rules! each {
        ($y:ident, |$v:ident| $step:expr) => {{
            for $v in 0..V {
                // SAFETY: there are no registers without `Avx512`.
                $y.0[$v] = unsafe { $step };
            }
            $y
        }};
    }

    impl<const V: usize> Lanes for Registers<V> {
        type Can = Avx512;

        #[inline(always)]
        fn constant(_: Avx512, x: f32) -> Self {
            // SAFETY: the features are there.
            Self([unsafe { kept(x) }; V])
        }
        #[inline(always)]
        fn plus(mut self, other: Self) -> Self {
            each!(self, |v| _mm512_add_ps(self.0[v], other.0[v]))
        }
        #[inline(always)]
        fn times(mut self, other: Self) -> Self {
            each!(self, |v| _mm512_mul_ps(self.0[v], other.0[v]))
        }
        #[inline(always)]
        fn mul_add<const FMA: bool>(mut self, b: Self, c: Self) -> Self {
            if !FMA {
                return self.times(b).plus(c);
            }
            each!(self, |v| _mm512_fmadd_ps(self.0[v], b.0[v], c.0[v]))
        }
        // Of two numbers, of which one is NaN, the instruction gives the second.
        #[inline(always)]
        fn at_least(mut self, bound: Self) -> Self {
            each!(self, |v| _mm512_max_ps(bound.0[v], self.0[v]))
        }
        #[inline(always)]
        fn if_positive(self, then: Self, mut otherwise: Self) -> Self {
            each!(otherwise, |v| {
                let positive = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self.0[v], _mm512_setzero_ps());
                _mm512_mask_mov_ps(otherwise.0[v], positive, then.0[v])
            })
        }
        #[inline(always)]
        fn times_power_of_two(mut self, n: Self, _: Self) -> Self {
            each!(self, |v| _mm512_scalef_ps(self.0[v], n.0[v]))
        }
    }
}
