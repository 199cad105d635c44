//! `f32` in one register of AVX-512: sixteen in one of 512 bits, eight in one of 256.
//!
//! Where a processor works through 512 bits in two halves, eight lanes have the same throughput; they are for groups that would leave half of sixteen idle.
#![expect(unsafe_code, reason = "vector intrinsics have no safe form")]
#![allow(clippy::wildcard_imports, reason = "both widths see the same names")]

use std::arch::x86_64::{_CMP_EQ_OQ, _CMP_LE_OQ, _CMP_LT_OQ, _CMP_NLT_UQ};
use std::ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub, SubAssign};

use super::operators::{Mask16, bit_mask, derive_operators, operator};
use crate::scalar::bf16::{self, Native, PairProducts, WeightPair};
use crate::scalar::real::WithoutNative;
use crate::scalar::single::single_precision_functions;
use crate::scalar::{Kernel, LaneFn, Mask, PairKernel, Real, elementary};

/// Bits of the sign of an `f32`.
const SIGN: i32 = i32::MIN;

bit_mask!(Mask8, u8);

/// A lane type: its text is the same for both widths, with the intrinsics by their names without the width.
macro_rules! back_end {
    ($vector:ident, $mask:ident($bits:ident), $pair:ident, $lanes:literal) => {
        #[doc = concat!("Two bfloat16 in each of ", stringify!($lanes), " lanes.")]
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct $pair(Ints);

        #[doc = concat!(stringify!($lanes), " `f32` in one register.")]
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct $vector(Floats);

        operator!($vector, Add, add, |a, b| $vector(add_ps(a.0, b.0)));
        operator!($vector, Sub, sub, |a, b| $vector(sub_ps(a.0, b.0)));
        operator!($vector, Mul, mul, |a, b| $vector(mul_ps(a.0, b.0)));
        operator!($vector, Div, div, |a, b| $vector(div_ps(a.0, b.0)));
        derive_operators!($vector);

        impl Neg for $vector {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                // −0 − x is −x for every number; the compiler knows it as a negation and folds it into multiply-adds.
                // SAFETY: values of this type exist only once `dispatch_on` or `dispatch_for` has found AVX-512.
                Self(unsafe { sub_ps(set1_ps(-0.0), self.0) })
            }
        }

        impl PartialEq for $vector {
            #[inline(always)]
            fn eq(&self, other: &Self) -> bool {
                // SAFETY: as above.
                unsafe { cmp_ps_mask::<_CMP_EQ_OQ>(self.0, other.0) == $bits::MAX }
            }
        }

        impl $vector {
            /// Bits whose upper half is the nearest bfloat16, ties to even; zero below the smallest that is kept.
            #[inline(always)]
            fn rounded_to_bf16(self) -> Ints {
                // SAFETY: features as above.
                unsafe {
                    let bits = castps_si(self.0);
                    let even = and_si(srli_epi32::<16>(bits), set1_epi32(1));
                    let up = add_epi32(even, set1_epi32(0x7fff));
                    // Not less, so that what is not a number stays so.
                    let smallest = set1_ps(bf16::SMALLEST);
                    let keep = cmp_ps_mask::<_CMP_NLT_UQ>(self.abs().0, smallest);
                    maskz_add_epi32(keep, bits, up)
                }
            }
            #[inline(always)]
            fn to_array(self) -> [f32; $lanes] {
                let mut a = [0.0; $lanes];
                // SAFETY: `a` has room for as many numbers, and the store asks for no alignment; features as above.
                unsafe { storeu_ps(a.as_mut_ptr(), self.0) };
                a
            }
        }

        impl Real for $vector {
            const LANES: usize = $lanes;
            type Mask = $mask;
            type Pair = $pair;
            type Register = sixteen::F32x16Avx512;

            #[inline(always)]
            fn join(rows: &[Self], stride: usize) -> Self::Register {
                join(rows, stride)
            }
            #[inline(always)]
            fn part(register: Self::Register, i: usize) -> Self {
                part(register, i)
            }
            #[inline(always)]
            fn to_bf16(self) -> Self {
                // SAFETY: as for `splat`.
                unsafe {
                    let upper = set1_epi32(0xffff_0000_u32 as i32);
                    Self(castsi_ps(and_si(self.rounded_to_bf16(), upper)))
                }
            }
            #[inline(always)]
            fn pair(first: Self, second: Self) -> $pair {
                // SAFETY: as for `splat`.
                unsafe {
                    let upper = set1_epi32(0xffff_0000_u32 as i32);
                    let low = srli_epi32::<16>(first.rounded_to_bf16());
                    $pair(or_si(low, and_si(second.rounded_to_bf16(), upper)))
                }
            }
            #[inline(always)]
            fn add_pair_product<P: PairProducts>(self, x: $pair, w: WeightPair, by: P) -> Self {
                // SAFETY: as for `splat`; there is no `Native` without AVX-512 BF16. The transmuted types are of one size, and every bit pattern is a value of both.
                unsafe {
                    if by.native().is_some() {
                        let w = set1_epi32(w.0 as i32);
                        Self(dpbf16_ps(
                            self.0,
                            std::mem::transmute::<Ints, Bf16s>(x.0),
                            std::mem::transmute::<Ints, Bf16s>(w),
                        ))
                    } else {
                        let upper = set1_epi32(0xffff_0000_u32 as i32);
                        let [first, second] = w.widened();
                        let (first, second) = (set1_ps(first), set1_ps(second));
                        let x_first = castsi_ps(slli_epi32::<16>(x.0));
                        let x_second = castsi_ps(and_si(x.0, upper));
                        Self(fmadd_ps(x_first, first, fmadd_ps(x_second, second, self.0)))
                    }
                }
            }
            #[inline(always)]
            fn compiled_for_pairs<K: PairKernel<Self>>(kernel: K) -> K::Output {
                if let Some(native) = Native::detect() {
                    // SAFETY: as for `splat`, and the feature was just found.
                    return unsafe { run_with_bf16(kernel, native) };
                }
                Self::compiled(WithoutNative(kernel))
            }

            #[inline(always)]
            fn splat(x: f64) -> Self {
                // SAFETY: only code entered through `dispatch_on` and `dispatch_for` names this type; they have found AVX-512.
                Self(unsafe { set1_ps(x as f32) })
            }
            #[inline(always)]
            fn lane(self, i: usize) -> f64 {
                f64::from(self.to_array()[i])
            }
            #[inline(always)]
            fn set_lane(&mut self, i: usize, x: f64) {
                // SAFETY: as for `splat`.
                self.0 = unsafe { mask_blend_ps(1 << i, self.0, set1_ps(x as f32)) };
            }
            #[inline(always)]
            fn mul_add(self, a: Self, b: Self) -> Self {
                // SAFETY: as for `splat`; so for every block below.
                Self(unsafe { fmadd_ps(self.0, a.0, b.0) })
            }
            #[inline(always)]
            fn neg_mul_add(self, a: Self, b: Self) -> Self {
                // SAFETY: as for `splat`.
                Self(unsafe { fnmadd_ps(self.0, a.0, b.0) })
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                // SAFETY: as for `splat`.
                Self(unsafe { sqrt_ps(self.0) })
            }
            #[inline(always)]
            fn abs(self) -> Self {
                // SAFETY: as for `splat`.
                unsafe {
                    let bits = and_si(castps_si(self.0), set1_epi32(!SIGN));
                    Self(castsi_ps(bits))
                }
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                // SAFETY: as for `splat`.
                Self(unsafe { min_ps(self.0, other.0) })
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                // SAFETY: as for `splat`.
                Self(unsafe { max_ps(self.0, other.0) })
            }
            #[inline(always)]
            fn round(self) -> Self {
                // SAFETY: as for `splat`. 0x08: to nearest even, no exceptions.
                Self(unsafe { roundscale_ps::<0x08>(self.0) })
            }
            #[inline(always)]
            fn floor(self) -> Self {
                // SAFETY: as for `splat`. 0x09: towards −∞, no exceptions.
                Self(unsafe { roundscale_ps::<0x09>(self.0) })
            }
            #[inline(always)]
            fn lt(self, other: Self) -> $mask {
                // SAFETY: as for `splat`.
                $mask(unsafe { cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) })
            }
            #[inline(always)]
            fn le(self, other: Self) -> $mask {
                // SAFETY: as for `splat`.
                $mask(unsafe { cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) })
            }
            #[inline(always)]
            fn select(m: $mask, a: Self, b: Self) -> Self {
                // SAFETY: as for `splat`.
                Self(unsafe { mask_blend_ps(m.0, b.0, a.0) })
            }
            #[inline(always)]
            fn copy_sign_to(self, magnitude: Self) -> Self {
                // SAFETY: as for `splat`.
                unsafe {
                    let sign = set1_epi32(SIGN);
                    let s = and_si(castps_si(self.0), sign);
                    let m = andnot_si(sign, castps_si(magnitude.0));
                    Self(castsi_ps(or_si(s, m)))
                }
            }
            #[inline(always)]
            fn pow2i(self) -> Self {
                // SAFETY: as for `splat`.
                unsafe {
                    let k = add_epi32(cvtps_epi32(self.0), set1_epi32(127));
                    Self(castsi_ps(slli_epi32::<23>(k)))
                }
            }
            #[inline(always)]
            fn frexp(self) -> (Self, Self) {
                // SAFETY: as for `splat`.
                unsafe {
                    let bits = castps_si(self.0);
                    let e = and_si(srli_epi32::<23>(bits), set1_epi32(0xff));
                    let e = cvtepi32_ps(sub_epi32(e, set1_epi32(126)));
                    let m = and_si(bits, set1_epi32(0x807f_ffff_u32 as i32));
                    let m = or_si(m, set1_epi32(0x3f00_0000));
                    (Self(castsi_ps(m)), Self(e))
                }
            }
            #[inline(always)]
            fn compiled<K: Kernel<Self>>(kernel: K) -> K::Output {
                // SAFETY: as for `splat`.
                unsafe { run(kernel) }
            }
            single_precision_functions!();
        }

        /// Runs `f` with this type.
        #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,fma")]
        pub(crate) fn call<F: LaneFn>(f: F) -> F::Output {
            f.call::<$vector>()
        }

        #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,fma")]
        #[inline(never)]
        fn run<K: Kernel<$vector>>(kernel: K) -> K::Output {
            kernel.run()
        }

        #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,avx512bf16,fma")]
        #[inline(never)]
        fn run_with_bf16<K: PairKernel<$vector>>(kernel: K, native: Native) -> K::Output {
            kernel.run(native)
        }
    };
}

pub(super) mod sixteen {
    use std::arch::x86_64::{
        __m256, __m512 as Floats, __m512bh as Bf16s, __m512i as Ints,
        _mm512_add_epi32 as add_epi32, _mm512_add_ps as add_ps, _mm512_and_si512 as and_si,
        _mm512_andnot_si512 as andnot_si, _mm512_castps_si512 as castps_si, _mm512_castps256_ps512,
        _mm512_castps512_ps256, _mm512_castsi512_ps as castsi_ps,
        _mm512_cmp_ps_mask as cmp_ps_mask, _mm512_cvtepi32_ps as cvtepi32_ps,
        _mm512_cvtps_epi32 as cvtps_epi32, _mm512_div_ps as div_ps, _mm512_dpbf16_ps as dpbf16_ps,
        _mm512_extractf32x8_ps, _mm512_fmadd_ps as fmadd_ps, _mm512_fnmadd_ps as fnmadd_ps,
        _mm512_insertf32x8, _mm512_mask_blend_ps as mask_blend_ps,
        _mm512_maskz_add_epi32 as maskz_add_epi32, _mm512_max_ps as max_ps,
        _mm512_min_ps as min_ps, _mm512_mul_ps as mul_ps, _mm512_or_si512 as or_si,
        _mm512_roundscale_ps as roundscale_ps, _mm512_set1_epi32 as set1_epi32,
        _mm512_set1_ps as set1_ps, _mm512_slli_epi32 as slli_epi32, _mm512_sqrt_ps as sqrt_ps,
        _mm512_srli_epi32 as srli_epi32, _mm512_storeu_ps as storeu_ps,
        _mm512_sub_epi32 as sub_epi32, _mm512_sub_ps as sub_ps,
    };

    use super::*;

    back_end!(F32x16Avx512, Mask16(u16), PairX16, 16);

    #[inline(always)]
    fn join(rows: &[F32x16Avx512], _: usize) -> F32x16Avx512 {
        rows[0]
    }

    #[inline(always)]
    fn part(register: F32x16Avx512, _: usize) -> F32x16Avx512 {
        register
    }

    impl F32x16Avx512 {
        /// `low` and `high` side by side.
        #[inline(always)]
        pub(super) fn of_halves(low: __m256, high: __m256) -> Self {
            // SAFETY: values of these types exist only where there is AVX-512.
            Self(unsafe { _mm512_insertf32x8::<1>(_mm512_castps256_ps512(low), high) })
        }

        /// What [`of_halves`](Self::of_halves) put together.
        #[inline(always)]
        pub(super) fn half(self, i: usize) -> __m256 {
            // SAFETY: as above.
            unsafe {
                if i == 0 {
                    _mm512_castps512_ps256(self.0)
                } else {
                    _mm512_extractf32x8_ps::<1>(self.0)
                }
            }
        }
    }
}

pub(super) mod eight {
    use std::arch::x86_64::{
        __m256 as Floats, __m256bh as Bf16s, __m256i as Ints, _mm256_add_epi32 as add_epi32,
        _mm256_add_ps as add_ps, _mm256_and_si256 as and_si, _mm256_andnot_si256 as andnot_si,
        _mm256_castps_si256 as castps_si, _mm256_castsi256_ps as castsi_ps,
        _mm256_cmp_ps_mask as cmp_ps_mask, _mm256_cvtepi32_ps as cvtepi32_ps,
        _mm256_cvtps_epi32 as cvtps_epi32, _mm256_div_ps as div_ps, _mm256_dpbf16_ps as dpbf16_ps,
        _mm256_fmadd_ps as fmadd_ps, _mm256_fnmadd_ps as fnmadd_ps,
        _mm256_mask_blend_ps as mask_blend_ps, _mm256_maskz_add_epi32 as maskz_add_epi32,
        _mm256_max_ps as max_ps, _mm256_min_ps as min_ps, _mm256_mul_ps as mul_ps,
        _mm256_or_si256 as or_si, _mm256_roundscale_ps as roundscale_ps,
        _mm256_set1_epi32 as set1_epi32, _mm256_set1_ps as set1_ps,
        _mm256_slli_epi32 as slli_epi32, _mm256_sqrt_ps as sqrt_ps,
        _mm256_srli_epi32 as srli_epi32, _mm256_storeu_ps as storeu_ps,
        _mm256_sub_epi32 as sub_epi32, _mm256_sub_ps as sub_ps,
    };

    use super::sixteen::F32x16Avx512;
    use super::*;

    back_end!(F32x8Avx512, Mask8(u8), PairX8, 8);

    #[inline(always)]
    fn join(rows: &[F32x8Avx512], stride: usize) -> F32x16Avx512 {
        F32x16Avx512::of_halves(rows[0].0, rows[stride].0)
    }

    #[inline(always)]
    fn part(register: F32x16Avx512, i: usize) -> F32x8Avx512 {
        F32x8Avx512(register.half(i))
    }
}
