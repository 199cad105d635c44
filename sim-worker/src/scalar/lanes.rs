//! Sixteen `f32` side by side, in three back ends of the same bits, and the choice among them.
//!
//! The arithmetic of [`F32x16Avx512`] and [`F32x16Avx2`] is processor intrinsics behind `#[inline(always)]`: they become single instructions
//! where they are inlined into the functions at the end of this file that enable the processor features, and [`dispatch_on`]
//! enters those only after asking the processor. Values of these types exist only inside such a call.
#![expect(
    unsafe_code,
    reason = "vector intrinsics and calls of functions compiled for detected processor features have no safe form"
)]

use std::ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub, SubAssign};

use super::bf16::{self, PairKernel, WeightPair, WithoutNative, pairs_side_by_side};
use super::single::{self, single_precision_functions};
use super::{Kernel, LANES, Mask, Real, elementary};

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m256, __m512, __m512bh, __m512i, __mmask16, _CMP_EQ_OQ, _CMP_LE_OQ, _CMP_LT_OQ, _CMP_NLT_UQ,
    _mm256_add_epi32, _mm256_add_ps, _mm256_and_ps, _mm256_and_si256, _mm256_andnot_ps,
    _mm256_blendv_ps, _mm256_castps_si256, _mm256_castsi256_ps, _mm256_cmp_ps, _mm256_cvtepi32_ps,
    _mm256_cvtps_epi32, _mm256_div_ps, _mm256_floor_ps, _mm256_fmadd_ps, _mm256_fnmadd_ps,
    _mm256_loadu_ps, _mm256_max_ps, _mm256_min_ps, _mm256_movemask_ps, _mm256_mul_ps, _mm256_or_ps,
    _mm256_or_si256, _mm256_round_ps, _mm256_set1_epi32, _mm256_set1_ps, _mm256_slli_epi32,
    _mm256_sqrt_ps, _mm256_srli_epi32, _mm256_storeu_ps, _mm256_sub_epi32, _mm256_sub_ps,
    _mm256_xor_ps, _mm512_add_epi32, _mm512_add_ps, _mm512_and_si512, _mm512_andnot_si512,
    _mm512_castps_si512, _mm512_castsi512_ps, _mm512_cmp_ps_mask, _mm512_cvtepi32_ps,
    _mm512_cvtps_epi32, _mm512_div_ps, _mm512_dpbf16_ps, _mm512_fmadd_ps, _mm512_fnmadd_ps,
    _mm512_loadu_ps, _mm512_mask_blend_ps, _mm512_maskz_add_epi32, _mm512_max_ps, _mm512_min_ps,
    _mm512_mul_ps, _mm512_or_si512, _mm512_roundscale_ps, _mm512_set1_epi32, _mm512_set1_ps,
    _mm512_slli_epi32, _mm512_sqrt_ps, _mm512_srli_epi32, _mm512_storeu_ps, _mm512_sub_epi32,
    _mm512_sub_ps,
};

/// Bits of the sign of an `f32`.
const SIGN: i32 = i32::MIN;

/// One bit per lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mask16(u16);

impl BitAnd for Mask16 {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}
impl BitOr for Mask16 {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}
impl Not for Mask16 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(!self.0)
    }
}
impl Mask for Mask16 {
    #[inline(always)]
    fn splat(value: bool) -> Self {
        Self(if value { u16::MAX } else { 0 })
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0 != 0
    }
    #[inline(always)]
    fn all(self) -> bool {
        self.0 == u16::MAX
    }
    #[inline(always)]
    fn lane(self, i: usize) -> bool {
        self.0 >> i & 1 == 1
    }
    #[inline(always)]
    fn set_lane(&mut self, i: usize, value: bool) {
        self.0 = self.0 & !(1 << i) | u16::from(value) << i;
    }
}

/// The parts of [`Real`] and of its supertraits that follow from a type's few basic operations.
macro_rules! derive_operators {
    ($t:ident) => {
        impl Default for $t {
            #[inline(always)]
            fn default() -> Self {
                Self::splat(0.0)
            }
        }
        impl AddAssign for $t {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
        impl SubAssign for $t {
            #[inline(always)]
            fn sub_assign(&mut self, other: Self) {
                *self = *self - other;
            }
        }
        impl MulAssign for $t {
            #[inline(always)]
            fn mul_assign(&mut self, other: Self) {
                *self = *self * other;
            }
        }
    };
}

/// A binary operator of an intrinsic type.
macro_rules! operator {
    ($t:ident, $trait:ident, $f:ident, |$a:ident, $b:ident| $e:expr) => {
        impl $trait for $t {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                // SAFETY: values of this type exist only where `dispatch_on` has found the processor features.
                unsafe { $e }
            }
        }
    };
}

// ---- portable -----------------------------------------------------------------------------------

/// Sixteen `f32` in plain Rust: any processor. Without hardware fused multiply-add it is slow and still right.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct F32x16Portable([f32; LANES]);

impl F32x16Portable {
    #[inline(always)]
    fn map(self, f: impl Fn(f32) -> f32) -> Self {
        let mut r = self;
        for x in &mut r.0 {
            *x = f(*x);
        }
        r
    }
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut r = self;
        for i in 0..LANES {
            r.0[i] = f(self.0[i], other.0[i]);
        }
        r
    }
    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(f32, f32) -> bool) -> Mask16 {
        let mut m = 0;
        for i in 0..LANES {
            m |= u16::from(f(self.0[i], other.0[i])) << i;
        }
        Mask16(m)
    }
}

impl Add for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}
impl Sub for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}
impl Mul for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}
impl Div for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}
impl Neg for F32x16Portable {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}
derive_operators!(F32x16Portable);

impl Real for F32x16Portable {
    const LANES: usize = LANES;
    type Mask = Mask16;
    pairs_side_by_side!(|x: Self| x.map(bf16::round));

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x as f32; LANES])
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        f64::from(self.0[i])
    }
    #[inline(always)]
    fn set_lane(&mut self, i: usize, x: f64) {
        self.0[i] = x as f32;
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        let mut r = self;
        for i in 0..LANES {
            r.0[i] = self.0[i].mul_add(a.0[i], b.0[i]);
        }
        r
    }
    #[inline(always)]
    fn neg_mul_add(self, a: Self, b: Self) -> Self {
        (-self).mul_add(a, b)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(f32::sqrt)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.map(f32::abs)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, single::min)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, single::max)
    }
    #[inline(always)]
    fn round(self) -> Self {
        self.map(f32::round_ties_even)
    }
    #[inline(always)]
    fn floor(self) -> Self {
        self.map(f32::floor)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Mask16 {
        self.compare(other, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Mask16 {
        self.compare(other, |a, b| a <= b)
    }
    #[inline(always)]
    fn select(m: Mask16, a: Self, b: Self) -> Self {
        let mut r = b;
        for i in 0..LANES {
            if m.lane(i) {
                r.0[i] = a.0[i];
            }
        }
        r
    }
    #[inline(always)]
    fn copy_sign_to(self, magnitude: Self) -> Self {
        self.zip(magnitude, |s, m| m.copysign(s))
    }
    #[inline(always)]
    fn pow2i(self) -> Self {
        self.map(single::pow2i)
    }
    #[inline(always)]
    fn frexp(self) -> (Self, Self) {
        (self.map(|x| single::frexp(x).0), self.map(|x| single::frexp(x).1))
    }
    single_precision_functions!();
}

// ---- AVX-512 ------------------------------------------------------------------------------------

/// Two bfloat16 in each of sixteen lanes.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub struct PairAvx512(__m512i);

/// Sixteen `f32` in one AVX-512 register.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub struct F32x16Avx512(__m512);

#[cfg(target_arch = "x86_64")]
#[allow(
    clippy::wildcard_imports,
    reason = "half of the file's names are the back end's intrinsics"
)]
mod avx512 {
    use super::*;

    operator!(F32x16Avx512, Add, add, |a, b| F32x16Avx512(_mm512_add_ps(a.0, b.0)));
    operator!(F32x16Avx512, Sub, sub, |a, b| F32x16Avx512(_mm512_sub_ps(a.0, b.0)));
    operator!(F32x16Avx512, Mul, mul, |a, b| F32x16Avx512(_mm512_mul_ps(a.0, b.0)));
    operator!(F32x16Avx512, Div, div, |a, b| F32x16Avx512(_mm512_div_ps(a.0, b.0)));
    derive_operators!(F32x16Avx512);

    impl Neg for F32x16Avx512 {
        type Output = Self;
        #[inline(always)]
        fn neg(self) -> Self {
            // −0 − x is −x for every number; the compiler knows it as a negation and folds it into multiply-adds.
            // SAFETY: values of this type exist only where `dispatch_on` has found AVX-512.
            Self(unsafe { _mm512_sub_ps(_mm512_set1_ps(-0.0), self.0) })
        }
    }

    impl PartialEq for F32x16Avx512 {
        #[inline(always)]
        fn eq(&self, other: &Self) -> bool {
            // SAFETY: as above.
            unsafe { _mm512_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, other.0) == u16::MAX }
        }
    }

    impl F32x16Avx512 {
        /// Bits whose upper half is the nearest bfloat16, ties to even; zero below the smallest that is kept.
        #[inline(always)]
        fn rounded_to_bf16(self) -> __m512i {
            // SAFETY: features as above.
            unsafe {
                let bits = _mm512_castps_si512(self.0);
                let even = _mm512_and_si512(_mm512_srli_epi32::<16>(bits), _mm512_set1_epi32(1));
                let up = _mm512_add_epi32(even, _mm512_set1_epi32(0x7fff));
                // Not less, so that what is not a number stays so.
                let smallest = _mm512_set1_ps(bf16::SMALLEST);
                let keep = _mm512_cmp_ps_mask::<_CMP_NLT_UQ>(self.abs().0, smallest);
                _mm512_maskz_add_epi32(keep, bits, up)
            }
        }
        #[inline(always)]
        fn to_array(self) -> [f32; LANES] {
            let mut a = [0.0; LANES];
            // SAFETY: `a` has room for sixteen numbers, and the store asks for no alignment; features as above.
            unsafe { _mm512_storeu_ps(a.as_mut_ptr(), self.0) };
            a
        }
        #[inline(always)]
        fn from_array(a: [f32; LANES]) -> Self {
            // SAFETY: `a` holds sixteen numbers, and the load asks for no alignment; features as above.
            Self(unsafe { _mm512_loadu_ps(a.as_ptr()) })
        }
    }

    impl Real for F32x16Avx512 {
        const LANES: usize = LANES;
        type Mask = Mask16;
        type Pair = PairAvx512;

        #[inline(always)]
        fn pair(first: Self, second: Self) -> PairAvx512 {
            // SAFETY: as for `splat`.
            unsafe {
                let upper = _mm512_set1_epi32(0xffff_0000_u32 as i32);
                let low = _mm512_srli_epi32::<16>(first.rounded_to_bf16());
                PairAvx512(_mm512_or_si512(low, _mm512_and_si512(second.rounded_to_bf16(), upper)))
            }
        }
        #[inline(always)]
        fn add_pair_product<const NATIVE: bool>(self, x: PairAvx512, w: WeightPair) -> Self {
            // SAFETY: as for `splat`; `compiled_for_pairs` has found AVX-512 BF16 where `NATIVE` is set. The transmuted types are 512 bits each.
            unsafe {
                if NATIVE {
                    let w = _mm512_set1_epi32(w.0 as i32);
                    Self(_mm512_dpbf16_ps(
                        self.0,
                        std::mem::transmute::<__m512i, __m512bh>(x.0),
                        std::mem::transmute::<__m512i, __m512bh>(w),
                    ))
                } else {
                    let upper = _mm512_set1_epi32(0xffff_0000_u32 as i32);
                    let [first, second] = w.widened().map(|w| _mm512_set1_ps(w));
                    let x_first = _mm512_castsi512_ps(_mm512_slli_epi32::<16>(x.0));
                    let x_second = _mm512_castsi512_ps(_mm512_and_si512(x.0, upper));
                    Self(_mm512_fmadd_ps(x_first, first, _mm512_fmadd_ps(x_second, second, self.0)))
                }
            }
        }
        #[inline(always)]
        fn compiled_for_pairs<K: PairKernel<Self>>(kernel: K) -> K::Output {
            if std::arch::is_x86_feature_detected!("avx512bf16") {
                // SAFETY: as for `splat`, and the feature was just found.
                return unsafe { run_avx512_bf16(kernel) };
            }
            Self::compiled(WithoutNative(kernel))
        }

        #[inline(always)]
        fn splat(x: f64) -> Self {
            // SAFETY: only code entered through `dispatch_on` names this type; it has found AVX-512.
            Self(unsafe { _mm512_set1_ps(x as f32) })
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
            Self(unsafe { _mm512_fmadd_ps(self.0, a.0, b.0) })
        }
        #[inline(always)]
        fn neg_mul_add(self, a: Self, b: Self) -> Self {
            // SAFETY: as for `splat`.
            Self(unsafe { _mm512_fnmadd_ps(self.0, a.0, b.0) })
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            // SAFETY: as for `splat`.
            Self(unsafe { _mm512_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn abs(self) -> Self {
            // SAFETY: as for `splat`.
            unsafe {
                let bits = _mm512_and_si512(_mm512_castps_si512(self.0), _mm512_set1_epi32(!SIGN));
                Self(_mm512_castsi512_ps(bits))
            }
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            // SAFETY: as for `splat`.
            Self(unsafe { _mm512_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            // SAFETY: as for `splat`.
            Self(unsafe { _mm512_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn round(self) -> Self {
            // SAFETY: as for `splat`. 0x08: to nearest even, no exceptions.
            Self(unsafe { _mm512_roundscale_ps::<0x08>(self.0) })
        }
        #[inline(always)]
        fn floor(self) -> Self {
            // SAFETY: as for `splat`. 0x09: towards −∞, no exceptions.
            Self(unsafe { _mm512_roundscale_ps::<0x09>(self.0) })
        }
        #[inline(always)]
        fn lt(self, other: Self) -> Mask16 {
            // SAFETY: as for `splat`.
            Mask16(unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) })
        }
        #[inline(always)]
        fn le(self, other: Self) -> Mask16 {
            // SAFETY: as for `splat`.
            Mask16(unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) })
        }
        #[inline(always)]
        fn select(m: Mask16, a: Self, b: Self) -> Self {
            let m: __mmask16 = m.0;
            // SAFETY: as for `splat`.
            Self(unsafe { _mm512_mask_blend_ps(m, b.0, a.0) })
        }
        #[inline(always)]
        fn copy_sign_to(self, magnitude: Self) -> Self {
            // SAFETY: as for `splat`.
            unsafe {
                let sign = _mm512_set1_epi32(SIGN);
                let s = _mm512_and_si512(_mm512_castps_si512(self.0), sign);
                let m = _mm512_andnot_si512(sign, _mm512_castps_si512(magnitude.0));
                Self(_mm512_castsi512_ps(_mm512_or_si512(s, m)))
            }
        }
        #[inline(always)]
        fn pow2i(self) -> Self {
            // SAFETY: as for `splat`.
            unsafe {
                let k = _mm512_add_epi32(_mm512_cvtps_epi32(self.0), _mm512_set1_epi32(127));
                Self(_mm512_castsi512_ps(_mm512_slli_epi32::<23>(k)))
            }
        }
        #[inline(always)]
        fn frexp(self) -> (Self, Self) {
            // SAFETY: as for `splat`.
            unsafe {
                let bits = _mm512_castps_si512(self.0);
                let e = _mm512_and_si512(_mm512_srli_epi32::<23>(bits), _mm512_set1_epi32(0xff));
                let e = _mm512_cvtepi32_ps(_mm512_sub_epi32(e, _mm512_set1_epi32(126)));
                let m = _mm512_and_si512(bits, _mm512_set1_epi32(0x807f_ffff_u32 as i32));
                let m = _mm512_or_si512(m, _mm512_set1_epi32(0x3f00_0000));
                (Self(_mm512_castsi512_ps(m)), Self(e))
            }
        }
        #[inline(always)]
        fn compiled<K: Kernel<Self>>(kernel: K) -> K::Output {
            // SAFETY: as for `splat`.
            unsafe { run_avx512(kernel) }
        }
        single_precision_functions!();
    }
}

// ---- AVX2 ---------------------------------------------------------------------------------------

/// Sixteen `f32` in two AVX registers; needs AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub struct F32x16Avx2(__m256, __m256);

/// All bits of a lane set or none, in two AVX registers.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub struct Mask2x8(__m256, __m256);

#[cfg(target_arch = "x86_64")]
#[allow(
    clippy::wildcard_imports,
    reason = "half of the file's names are the back end's intrinsics"
)]
mod avx2 {
    use super::*;

    /// Applies an intrinsic to both halves.
    macro_rules! both {
        (|$a:ident| $e:expr, $x:expr) => {{
            let x = $x;
            // SAFETY: values of this type exist only where `dispatch_on` has found AVX2 and FMA.
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
            // SAFETY: values of this type exist only where `dispatch_on` has found AVX2 and FMA.
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
    operator!(Mask2x8, BitOr, bitor, |a, b| Mask2x8(
        _mm256_or_ps(a.0, b.0),
        _mm256_or_ps(a.1, b.1)
    ));
    impl Not for Mask2x8 {
        type Output = Self;
        #[inline(always)]
        fn not(self) -> Self {
            // SAFETY: values of this type exist only where `dispatch_on` has found AVX2 and FMA; so for every block below.
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
                    let even =
                        _mm256_and_si256(_mm256_srli_epi32::<16>(bits), _mm256_set1_epi32(1));
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
            unsafe { run_avx2(kernel) }
        }
        single_precision_functions!();
    }
}

// ---- dispatch -----------------------------------------------------------------------------------

/// A computation over sixteen lanes, to be compiled once per back end.
///
/// `call` and everything generic it uses must be `#[inline(always)]`.
pub trait LaneFn {
    /// What the computation returns.
    type Output;
    /// Runs the computation with lane type `S` (`S::LANES` = 16).
    fn call<S: Real>(self) -> Self::Output;
}

/// Implementation of the sixteen-lane type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// One 512-bit register (AVX-512 F, DQ, VL, BW).
    Avx512,
    /// Two 256-bit registers (AVX2, FMA).
    Avx2,
    /// Plain Rust.
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
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                std::arch::is_x86_feature_detected!("avx512f")
                    && std::arch::is_x86_feature_detected!("avx512dq")
                    && std::arch::is_x86_feature_detected!("avx512vl")
                    && std::arch::is_x86_feature_detected!("avx512bw")
                    && std::arch::is_x86_feature_detected!("fma")
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
        #[cfg(target_arch = "x86_64")]
        Backend::Avx512 => unsafe { call_avx512(f) },
        // SAFETY: the processor features were asserted above.
        #[cfg(target_arch = "x86_64")]
        Backend::Avx2 => unsafe { call_avx2(f) },
        _ => f.call::<F32x16Portable>(),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,fma")]
fn call_avx512<F: LaneFn>(f: F) -> F::Output {
    f.call::<F32x16Avx512>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn call_avx2<F: LaneFn>(f: F) -> F::Output {
    f.call::<F32x16Avx2>()
}

/// Runs a kernel of a lone scalar with the processor's fused multiply-add where it has one: the same bits as without, much faster.
#[inline(always)]
pub(super) fn run_scalar<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the processor features were just found.
        return unsafe { run_fma(kernel) };
    }
    super::run_apart(kernel)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn run_fma<S: Real, K: Kernel<S>>(kernel: K) -> K::Output {
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,fma")]
#[inline(never)]
fn run_avx512<K: Kernel<F32x16Avx512>>(kernel: K) -> K::Output {
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,avx512bf16,fma")]
#[inline(never)]
fn run_avx512_bf16<K: PairKernel<F32x16Avx512>>(kernel: K) -> K::Output {
    kernel.run::<true>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn run_avx2<K: Kernel<F32x16Avx2>>(kernel: K) -> K::Output {
    kernel.run()
}
