//! Eight `f32` in one AVX register.
//!
//! Sixteen in two were slower: of sixteen registers a value took two, so that sums of products and the dynamics went through memory.
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
use crate::scalar::bf16::{self, PairProducts, WeightPair};
use crate::scalar::real::fills_register;
use crate::scalar::single::single_precision_functions;
use crate::scalar::{Kernel, LaneFn, Mask, Real, elementary};

/// Lanes of a register.
const WIDTH: usize = 8;

/// Eight `f32` in one AVX register; needs AVX2 and FMA.
#[derive(Clone, Copy, Debug)]
pub(crate) struct F32x8Avx2(__m256);

/// All bits of a lane set or none.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mask8Avx2(__m256);

operator!(F32x8Avx2, Add, add, |a, b| F32x8Avx2(_mm256_add_ps(a.0, b.0)));
operator!(F32x8Avx2, Sub, sub, |a, b| F32x8Avx2(_mm256_sub_ps(a.0, b.0)));
operator!(F32x8Avx2, Mul, mul, |a, b| F32x8Avx2(_mm256_mul_ps(a.0, b.0)));
operator!(F32x8Avx2, Div, div, |a, b| F32x8Avx2(_mm256_div_ps(a.0, b.0)));
derive_operators!(F32x8Avx2);

operator!(Mask8Avx2, BitAnd, bitand, |a, b| Mask8Avx2(_mm256_and_ps(a.0, b.0)));
operator!(Mask8Avx2, BitOr, bitor, |a, b| Mask8Avx2(_mm256_or_ps(a.0, b.0)));
impl Not for Mask8Avx2 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        // SAFETY: values of this type exist only once `dispatch_on` has found AVX2 and FMA; so for every block below.
        unsafe { Self(_mm256_xor_ps(self.0, _mm256_castsi256_ps(_mm256_set1_epi32(-1)))) }
    }
}
impl PartialEq for Mask8Avx2 {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.bits() == other.bits()
    }
}
impl Mask8Avx2 {
    #[inline(always)]
    fn bits(self) -> u8 {
        // SAFETY: as above.
        unsafe { _mm256_movemask_ps(self.0) as u8 }
    }
    #[inline(always)]
    fn from_bits(bits: u8) -> Self {
        let mut a = [0.0_f32; WIDTH];
        for (i, x) in a.iter_mut().enumerate() {
            *x = f32::from_bits(if bits >> i & 1 == 1 { u32::MAX } else { 0 });
        }
        // SAFETY: `a` holds eight numbers, and the load asks for no alignment; features as above.
        unsafe { Self(_mm256_loadu_ps(a.as_ptr())) }
    }
}
impl Mask for Mask8Avx2 {
    #[inline(always)]
    fn splat(value: bool) -> Self {
        // SAFETY: as above.
        unsafe { Self(_mm256_castsi256_ps(_mm256_set1_epi32(if value { -1 } else { 0 }))) }
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.bits() != 0
    }
    #[inline(always)]
    fn all(self) -> bool {
        self.bits() == u8::MAX
    }
    #[inline(always)]
    fn lane(self, i: usize) -> bool {
        self.bits() >> i & 1 == 1
    }
    #[inline(always)]
    fn set_lane(&mut self, i: usize, value: bool) {
        *self = Self::from_bits(self.bits() & !(1 << i) | u8::from(value) << i);
    }
}

impl Neg for F32x8Avx2 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // As for AVX-512: a negation the compiler folds into multiply-adds.
        // SAFETY: as above.
        Self(unsafe { _mm256_sub_ps(_mm256_set1_ps(-0.0), self.0) })
    }
}
impl PartialEq for F32x8Avx2 {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        // SAFETY: as above.
        Mask8Avx2(unsafe { _mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, other.0) }).all()
    }
}

impl F32x8Avx2 {
    #[inline(always)]
    fn to_array(self) -> [f32; WIDTH] {
        let mut a = [0.0; WIDTH];
        // SAFETY: `a` has room for eight numbers, and the store asks for no alignment; features as above.
        unsafe { _mm256_storeu_ps(a.as_mut_ptr(), self.0) };
        a
    }
    #[inline(always)]
    fn from_array(a: [f32; WIDTH]) -> Self {
        // SAFETY: `a` holds eight numbers, and the load asks for no alignment; features as above.
        Self(unsafe { _mm256_loadu_ps(a.as_ptr()) })
    }
    /// The nearest bfloat16, ties to even; zero below the smallest that is kept.
    #[inline(always)]
    fn rounded_to_bf16(self) -> Self {
        // SAFETY: features as above.
        let rounded = unsafe {
            let bits = _mm256_castps_si256(self.0);
            let even = _mm256_and_si256(_mm256_srli_epi32::<16>(bits), _mm256_set1_epi32(1));
            let up = _mm256_add_epi32(even, _mm256_set1_epi32(0x7fff));
            let nearest = _mm256_add_epi32(bits, up);
            let upper = _mm256_set1_epi32(0xffff_0000_u32 as i32);
            Self(_mm256_castsi256_ps(_mm256_and_si256(nearest, upper)))
        };
        let small = self.abs().lt(Self::splat(f64::from(bf16::SMALLEST)));
        Self::select(small, Self::splat(0.0), rounded)
    }
}

impl Real for F32x8Avx2 {
    const LANES: usize = WIDTH;
    const PRODUCT_SUMS: usize = 8;
    type Mask = Mask8Avx2;
    fills_register!();
    type Pair = [Self; 2];

    #[inline(always)]
    fn to_bf16(self) -> Self {
        self.rounded_to_bf16()
    }
    #[inline(always)]
    fn pair(first: Self, second: Self) -> [Self; 2] {
        [first.rounded_to_bf16(), second.rounded_to_bf16()]
    }
    #[inline(always)]
    fn add_pair_product<P: PairProducts>(self, x: [Self; 2], w: WeightPair, _: P) -> Self {
        // SAFETY: as for `splat`. Widened in the vector, where there are units to spare, and not one by one before.
        unsafe {
            let w = _mm256_set1_epi32(w.0 as i32);
            let upper = _mm256_set1_epi32(0xffff_0000_u32 as i32);
            let first = _mm256_castsi256_ps(_mm256_slli_epi32::<16>(w));
            let second = _mm256_castsi256_ps(_mm256_and_si256(w, upper));
            let sum = _mm256_fmadd_ps(x[1].0, second, self.0);
            Self(_mm256_fmadd_ps(x[0].0, first, sum))
        }
    }

    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: only code entered through `dispatch_on` names this type; it has found AVX2 and FMA.
        Self(unsafe { _mm256_set1_ps(x as f32) })
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
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_fmadd_ps(self.0, a.0, b.0) })
    }
    #[inline(always)]
    fn neg_mul_add(self, a: Self, b: Self) -> Self {
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_fnmadd_ps(self.0, a.0, b.0) })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn round(self) -> Self {
        // 0x08: to nearest even, no exceptions.
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_round_ps::<0x08>(self.0) })
    }
    #[inline(always)]
    fn floor(self) -> Self {
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_floor_ps(self.0) })
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Mask8Avx2 {
        // SAFETY: as for `splat`.
        Mask8Avx2(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn le(self, other: Self) -> Mask8Avx2 {
        // SAFETY: as for `splat`.
        Mask8Avx2(unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn select(m: Mask8Avx2, a: Self, b: Self) -> Self {
        // SAFETY: as for `splat`.
        Self(unsafe { _mm256_blendv_ps(b.0, a.0, m.0) })
    }
    #[inline(always)]
    fn copy_sign_to(self, magnitude: Self) -> Self {
        // SAFETY: as for `splat`.
        unsafe {
            let sign = _mm256_set1_ps(-0.0);
            let s = _mm256_and_ps(sign, self.0);
            Self(_mm256_or_ps(s, _mm256_andnot_ps(sign, magnitude.0)))
        }
    }
    #[inline(always)]
    fn pow2i(self) -> Self {
        // SAFETY: as for `splat`.
        unsafe {
            let k = _mm256_add_epi32(_mm256_cvtps_epi32(self.0), _mm256_set1_epi32(127));
            Self(_mm256_castsi256_ps(_mm256_slli_epi32::<23>(k)))
        }
    }
    #[inline(always)]
    fn frexp(self) -> (Self, Self) {
        // SAFETY: as for `splat`.
        unsafe {
            let bits = _mm256_castps_si256(self.0);
            let e = _mm256_and_si256(_mm256_srli_epi32::<23>(bits), _mm256_set1_epi32(0xff));
            let e = _mm256_cvtepi32_ps(_mm256_sub_epi32(e, _mm256_set1_epi32(126)));
            let m = _mm256_and_si256(bits, _mm256_set1_epi32(0x807f_ffff_u32 as i32));
            let m = _mm256_or_si256(m, _mm256_set1_epi32(0x3f00_0000));
            (Self(_mm256_castsi256_ps(m)), Self(e))
        }
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
    f.call::<F32x8Avx2>()
}

#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn run<K: Kernel<F32x8Avx2>>(kernel: K) -> K::Output {
    kernel.run()
}
