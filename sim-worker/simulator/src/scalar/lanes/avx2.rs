//! Sixteen `f32` in two AVX registers.
#![expect(unsafe_code, reason = "vector intrinsics have no safe form")]

use std::arch::x86_64::{
    __m256, _CMP_EQ_OQ, _CMP_LE_OQ, _CMP_LT_OQ, _mm256_add_epi32, _mm256_add_ps, _mm256_and_ps,
    _mm256_and_si256, _mm256_andnot_ps, _mm256_blendv_ps, _mm256_castps_si256, _mm256_castsi256_ps,
    _mm256_cmp_ps, _mm256_cvtepi32_ps, _mm256_cvtps_epi32, _mm256_div_ps, _mm256_floor_ps,
    _mm256_fmadd_ps, _mm256_fnmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_min_ps,
    _mm256_movemask_ps, _mm256_mul_ps, _mm256_or_ps, _mm256_or_si256, _mm256_round_ps,
    _mm256_set1_epi32, _mm256_set1_ps, _mm256_slli_epi32, _mm256_sqrt_ps, _mm256_srli_epi32,
    _mm256_storeu_ps, _mm256_sub_epi32, _mm256_sub_ps, _mm256_xor_ps,
};
use std::ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub, SubAssign};

use super::operators::{derive_operators, operator};
use crate::scalar::bf16::{self, pairs_side_by_side};
use crate::scalar::single::single_precision_functions;
use crate::scalar::{Kernel, LANES, LaneFn, Mask, Real, elementary};

/// Sixteen `f32` in two AVX registers; needs AVX2 and FMA.
#[derive(Clone, Copy, Debug)]
pub(crate) struct F32x16Avx2(__m256, __m256);

/// All bits of a lane set or none, in two AVX registers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mask2x8(__m256, __m256);

/// Applies an intrinsic to both halves.
macro_rules! both {
    (|$a:ident| $e:expr, $x:expr) => {{
        let x = $x;
        // SAFETY: values of this type exist only once `dispatch_on` has found AVX2 and FMA.
        unsafe {
            F32x16Avx2(
                {
                    let $a = x.0;
                    $e
                },
                {
                    let $a = x.1;
                    $e
                },
            )
        }
    }};
    (|$a:ident, $b:ident| $e:expr, $x:expr, $y:expr) => {{
        let (x, y) = ($x, $y);
        // SAFETY: values of this type exist only once `dispatch_on` has found AVX2 and FMA.
        unsafe {
            F32x16Avx2(
                {
                    let ($a, $b) = (x.0, y.0);
                    $e
                },
                {
                    let ($a, $b) = (x.1, y.1);
                    $e
                },
            )
        }
    }};
}

operator!(F32x16Avx2, Add, add, |a, b| F32x16Avx2(
    _mm256_add_ps(a.0, b.0),
    _mm256_add_ps(a.1, b.1)
));
operator!(F32x16Avx2, Sub, sub, |a, b| F32x16Avx2(
    _mm256_sub_ps(a.0, b.0),
    _mm256_sub_ps(a.1, b.1)
));
operator!(F32x16Avx2, Mul, mul, |a, b| F32x16Avx2(
    _mm256_mul_ps(a.0, b.0),
    _mm256_mul_ps(a.1, b.1)
));
operator!(F32x16Avx2, Div, div, |a, b| F32x16Avx2(
    _mm256_div_ps(a.0, b.0),
    _mm256_div_ps(a.1, b.1)
));
derive_operators!(F32x16Avx2);

operator!(Mask2x8, BitAnd, bitand, |a, b| Mask2x8(
    _mm256_and_ps(a.0, b.0),
    _mm256_and_ps(a.1, b.1)
));
operator!(Mask2x8, BitOr, bitor, |a, b| Mask2x8(_mm256_or_ps(a.0, b.0), _mm256_or_ps(a.1, b.1)));
impl Not for Mask2x8 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        // SAFETY: values of this type exist only once `dispatch_on` has found AVX2 and FMA; so for every block below.
        unsafe {
            let ones = _mm256_castsi256_ps(_mm256_set1_epi32(-1));
            Self(_mm256_xor_ps(self.0, ones), _mm256_xor_ps(self.1, ones))
        }
    }
}
impl PartialEq for Mask2x8 {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.bits() == other.bits()
    }
}
impl Mask2x8 {
    #[inline(always)]
    fn bits(self) -> u16 {
        // SAFETY: as above.
        unsafe { (_mm256_movemask_ps(self.0) | _mm256_movemask_ps(self.1) << 8) as u16 }
    }
    #[inline(always)]
    fn from_bits(bits: u16) -> Self {
        let mut a = [0.0_f32; LANES];
        for (i, x) in a.iter_mut().enumerate() {
            *x = f32::from_bits(if bits >> i & 1 == 1 { u32::MAX } else { 0 });
        }
        // SAFETY: `a` holds sixteen numbers, and the loads ask for no alignment; features as above.
        unsafe { Self(_mm256_loadu_ps(a.as_ptr()), _mm256_loadu_ps(a[8..].as_ptr())) }
    }
}
impl Mask for Mask2x8 {
    #[inline(always)]
    fn splat(value: bool) -> Self {
        Self::from_bits(if value { u16::MAX } else { 0 })
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.bits() != 0
    }
    #[inline(always)]
    fn all(self) -> bool {
        self.bits() == u16::MAX
    }
    #[inline(always)]
    fn lane(self, i: usize) -> bool {
        self.bits() >> i & 1 == 1
    }
    #[inline(always)]
    fn set_lane(&mut self, i: usize, value: bool) {
        *self = Self::from_bits(self.bits() & !(1 << i) | u16::from(value) << i);
    }
}

impl Neg for F32x16Avx2 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // As for AVX-512: a negation the compiler folds into multiply-adds.
        both!(|a| _mm256_sub_ps(_mm256_set1_ps(-0.0), a), self)
    }
}
impl PartialEq for F32x16Avx2 {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        // SAFETY: as above.
        let m = unsafe {
            Mask2x8(
                _mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, other.0),
                _mm256_cmp_ps::<_CMP_EQ_OQ>(self.1, other.1),
            )
        };
        m.all()
    }
}

impl F32x16Avx2 {
    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        let mut a = [0.0; LANES];
        // SAFETY: `a` has room for sixteen numbers, and the stores ask for no alignment; features as above.
        unsafe {
            _mm256_storeu_ps(a.as_mut_ptr(), self.0);
            _mm256_storeu_ps(a[8..].as_mut_ptr(), self.1);
        }
        a
    }
    #[inline(always)]
    fn from_array(a: [f32; LANES]) -> Self {
        // SAFETY: `a` holds sixteen numbers, and the loads ask for no alignment; features as above.
        unsafe { Self(_mm256_loadu_ps(a.as_ptr()), _mm256_loadu_ps(a[8..].as_ptr())) }
    }
}

impl Real for F32x16Avx2 {
    const LANES: usize = LANES;
    type Mask = Mask2x8;
    pairs_side_by_side!(|x: Self| {
        let rounded = both!(
            |a| {
                let bits = _mm256_castps_si256(a);
                let even = _mm256_and_si256(_mm256_srli_epi32::<16>(bits), _mm256_set1_epi32(1));
                let up = _mm256_add_epi32(even, _mm256_set1_epi32(0x7fff));
                let nearest = _mm256_add_epi32(bits, up);
                let upper = _mm256_set1_epi32(0xffff_0000_u32 as i32);
                _mm256_castsi256_ps(_mm256_and_si256(nearest, upper))
            },
            x
        );
        let small = x.abs().lt(Self::splat(f64::from(bf16::SMALLEST)));
        Self::select(small, Self::splat(0.0), rounded)
    });

    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: only code entered through `dispatch_on` names this type; it has found AVX2 and FMA.
        unsafe { Self(_mm256_set1_ps(x as f32), _mm256_set1_ps(x as f32)) }
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        f64::from(self.to_array()[i])
    }
    #[inline(always)]
    fn set_lane(&mut self, i: usize, x: f64) {
        let mut a = self.to_array();
        a[i] = x as f32;
        *self = Self::from_array(a);
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        // SAFETY: as for `splat`; so for every block below.
        unsafe { Self(_mm256_fmadd_ps(self.0, a.0, b.0), _mm256_fmadd_ps(self.1, a.1, b.1)) }
    }
    #[inline(always)]
    fn neg_mul_add(self, a: Self, b: Self) -> Self {
        // SAFETY: as for `splat`.
        unsafe { Self(_mm256_fnmadd_ps(self.0, a.0, b.0), _mm256_fnmadd_ps(self.1, a.1, b.1)) }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        both!(|a| _mm256_sqrt_ps(a), self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        both!(|a| _mm256_andnot_ps(_mm256_set1_ps(-0.0), a), self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        both!(|a, b| _mm256_min_ps(a, b), self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        both!(|a, b| _mm256_max_ps(a, b), self, other)
    }
    #[inline(always)]
    fn round(self) -> Self {
        // 0x08: to nearest even, no exceptions.
        both!(|a| _mm256_round_ps::<0x08>(a), self)
    }
    #[inline(always)]
    fn floor(self) -> Self {
        both!(|a| _mm256_floor_ps(a), self)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Mask2x8 {
        // SAFETY: as for `splat`.
        unsafe {
            Mask2x8(
                _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0),
                _mm256_cmp_ps::<_CMP_LT_OQ>(self.1, other.1),
            )
        }
    }
    #[inline(always)]
    fn le(self, other: Self) -> Mask2x8 {
        // SAFETY: as for `splat`.
        unsafe {
            Mask2x8(
                _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0),
                _mm256_cmp_ps::<_CMP_LE_OQ>(self.1, other.1),
            )
        }
    }
    #[inline(always)]
    fn select(m: Mask2x8, a: Self, b: Self) -> Self {
        // SAFETY: as for `splat`.
        unsafe { Self(_mm256_blendv_ps(b.0, a.0, m.0), _mm256_blendv_ps(b.1, a.1, m.1)) }
    }
    #[inline(always)]
    fn copy_sign_to(self, magnitude: Self) -> Self {
        both!(
            |s, m| {
                let sign = _mm256_set1_ps(-0.0);
                _mm256_or_ps(_mm256_and_ps(sign, s), _mm256_andnot_ps(sign, m))
            },
            self,
            magnitude
        )
    }
    #[inline(always)]
    fn pow2i(self) -> Self {
        both!(
            |a| {
                let k = _mm256_add_epi32(_mm256_cvtps_epi32(a), _mm256_set1_epi32(127));
                _mm256_castsi256_ps(_mm256_slli_epi32::<23>(k))
            },
            self
        )
    }
    #[inline(always)]
    fn frexp(self) -> (Self, Self) {
        let mantissa = both!(
            |a| {
                let bits = _mm256_castps_si256(a);
                let m = _mm256_and_si256(bits, _mm256_set1_epi32(0x807f_ffff_u32 as i32));
                _mm256_castsi256_ps(_mm256_or_si256(m, _mm256_set1_epi32(0x3f00_0000)))
            },
            self
        );
        let exponent = both!(
            |a| {
                let e = _mm256_srli_epi32::<23>(_mm256_castps_si256(a));
                let e = _mm256_and_si256(e, _mm256_set1_epi32(0xff));
                _mm256_cvtepi32_ps(_mm256_sub_epi32(e, _mm256_set1_epi32(126)))
            },
            self
        );
        (mantissa, exponent)
    }
    #[inline(always)]
    fn compiled<K: Kernel<Self>>(kernel: K) -> K::Output {
        // SAFETY: as for `splat`.
        unsafe { run(kernel) }
    }
    single_precision_functions!();
}

#[target_feature(enable = "avx2,fma")]
pub(super) fn call<F: LaneFn>(f: F) -> F::Output {
    f.call::<F32x16Avx2>()
}

#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn run<K: Kernel<F32x16Avx2>>(kernel: K) -> K::Output {
    kernel.run()
}
