//! Products of bfloat16 pairs, as AVX-512 BF16 computes them, on any processor.
//!
//! bfloat16 is the upper half of an `f32`: eight digits of the mantissa. The processor's instruction
//! (VDPBF16PS) takes two such numbers a lane, multiplies them with two others and adds both products
//! to an `f32`, the second one first, each with one rounding [Intel, Software Developer's Manual,
//! vol. 2, VDPBF16PS]: twice the products of a fused multiply-add. Two fused multiply-adds are the
//! same to the bit, but for subnormal numbers, which the instruction takes for zero. There are none:
//! numbers below [`SMALLEST`] become zero when they are rounded, so that every product is a multiple
//! of 2⁻¹¹⁴, and so is every sum of them and of a bias that [`bias`] has let through.

/// What is smaller becomes zero.
pub(crate) const SMALLEST: f32 = 1.0 / (1_u64 << 50) as f32;

/// Two weights in bfloat16, the first in the lower half.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[repr(transparent)]
pub struct WeightPair(pub(super) u32);

impl WeightPair {
    /// Rounds two weights.
    pub fn new(first: f32, second: f32) -> Self {
        Self(round(first).to_bits() >> 16 | round(second).to_bits())
    }

    /// Both, widened exactly.
    #[inline(always)]
    pub fn widened(self) -> [f32; 2] {
        [f32::from_bits(self.0 << 16), f32::from_bits(self.0 & 0xffff_0000)]
    }
}

/// The nearest bfloat16, ties to even; zero where that is below 2⁻⁵⁰.
#[inline(always)]
pub fn round(x: f32) -> f32 {
    let bits = x.to_bits();
    let nearest = bits.wrapping_add(0x7fff + (bits >> 16 & 1)) & 0xffff_0000;
    if x.abs() < SMALLEST { 0.0 } else { f32::from_bits(nearest) }
}

/// A bias to which products may be added: zero where it is so small that a sum could become subnormal.
pub fn bias(x: f32) -> f32 {
    if x.abs() < SMALLEST * SMALLEST { 0.0 } else { x }
}

/// How products of pairs are computed. A kernel is compiled for each way, so that a look at `native` costs nothing.
pub trait PairProducts: Copy {
    /// The proof that the processor has an instruction for them, if that is to be used.
    fn native(self) -> Option<Native>;

    /// Whether products are rounded before they are added.
    ///
    /// A product of two bfloat16 has sixteen digits, so it is exact in an `f32` and the sum is that of a fused multiply-add, unless the product overflows:
    /// whoever computes so must compute again what is not finite in the end.
    #[inline(always)]
    fn rounded_apart(self) -> bool {
        false
    }
}

/// By two fused multiply-adds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fused;

impl PairProducts for Fused {
    #[inline(always)]
    fn native(self) -> Option<Native> {
        None
    }
}

/// By multiplications and additions.
#[cfg(any(test, target_arch = "wasm32"))]
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums;

#[cfg(any(test, target_arch = "wasm32"))]
impl PairProducts for Sums {
    #[inline(always)]
    fn native(self) -> Option<Native> {
        None
    }
    #[inline(always)]
    fn rounded_apart(self) -> bool {
        true
    }
}

/// By the processor's own instruction. Whoever has a value of this type knows that it is there.
#[derive(Debug, Clone, Copy)]
pub struct Native(());

impl Native {
    /// Asks the processor.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(super) fn detect() -> Option<Self> {
        std::arch::is_x86_feature_detected!("avx512bf16").then_some(Self(()))
    }
}

impl PairProducts for Native {
    #[inline(always)]
    fn native(self) -> Option<Native> {
        Some(self)
    }
}

/// Pairs as two numbers side by side, for scalars without a packed form. `$round` rounds a number to bfloat16.
macro_rules! pairs_side_by_side {
    ($round:expr) => {
        type Pair = [Self; 2];
        #[inline(always)]
        fn to_bf16(self) -> Self {
            $round(self)
        }
        #[inline(always)]
        fn pair(first: Self, second: Self) -> [Self; 2] {
            [first.to_bf16(), second.to_bf16()]
        }
        #[inline(always)]
        fn add_pair_product<P: crate::scalar::PairProducts>(
            self,
            x: [Self; 2],
            w: crate::scalar::WeightPair,
            by: P,
        ) -> Self {
            // Not by `map`: a closure that is not inlined is compiled without the processor features of its caller.
            let [first, second] = w.widened();
            let (first, second) = (Self::splat(f64::from(first)), Self::splat(f64::from(second)));
            if by.rounded_apart() {
                return x[0] * first + (x[1] * second + self);
            }
            x[0].mul_add(first, x[1].mul_add(second, self))
        }
    };
}
pub(super) use pairs_side_by_side;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::real::BySums;
    use crate::scalar::{Backend, LaneFn, PairKernel, Real, dispatch_for, dispatch_on};

    #[test]
    fn rounding_is_to_nearest_even_and_small_numbers_vanish() {
        // 1 + 2⁻⁸ lies between 1 and 1 + 2⁻⁷; the even neighbour is 1.
        for (x, rounded) in [
            (1.0, 1.0),
            (1.0 + 1.0 / 256.0, 1.0),
            (1.0 + 3.0 / 256.0, 1.0 + 4.0 / 256.0),
            (-1.0 - 1.1 / 256.0, -1.0 - 2.0 / 256.0),
            (1e-16, 0.0),
            (-1e-16, 0.0),
            (f32::INFINITY, f32::INFINITY),
        ] {
            assert_eq!(round(x), rounded, "{x}");
        }
        assert_eq!(WeightPair::new(1.0, -2.0).widened(), [1.0, -2.0]);
        assert!(round(f32::NAN).is_nan());
    }

    struct Products;
    impl LaneFn for Products {
        type Output = Vec<u32>;
        #[inline(always)]
        fn call<S: Real>(self) -> Vec<u32> {
            S::compiled_for_pairs(self)
        }
    }
    impl<S: Real> PairKernel<S> for Products {
        type Output = Vec<u32>;
        #[inline(always)]
        fn run<P: PairProducts>(self, products: P) -> Vec<u32> {
            let mut word = 1_u32;
            let mut next = || {
                word = word.wrapping_mul(1664525).wrapping_add(1013904223);
                // Of both signs, over sixty powers of two, so that sums cancel and small numbers vanish.
                let size = (f64::from(word >> 8 & 0xff) / 255.0 - 0.5) * 60.0;
                f64::from(word >> 16) / 32768.0
                    * size.exp2()
                    * if word & 0x80 == 0 { 1.0 } else { -1.0 }
            };
            let mut out = Vec::new();
            for call in 0..500 {
                let (mut first, mut second) = (S::zero(), S::zero());
                let mut sum = S::zero();
                for lane in 0..16 {
                    let (x, y, z) = (next(), next(), next());
                    if lane < S::LANES {
                        first.set_lane(lane, x);
                        second.set_lane(lane, y);
                        sum.set_lane(lane, z);
                    }
                }
                // What is not a number must not vanish among the small ones.
                first.set_lane(0, if call % 100 == 7 { f64::NAN } else { first.lane(0) });
                let w = WeightPair::new(next() as f32, next() as f32);
                let sum = sum.add_pair_product(S::pair(first, second), w, products);
                // All that is not a number alike: its sign depends on the instruction.
                let bits = |x: f32| if x.is_nan() { u32::MAX } else { x.to_bits() };
                out.extend((0..S::LANES).map(|lane| bits(sum.lane(lane) as f32)));
            }
            out
        }
    }

    #[test]
    fn every_back_end_computes_the_same_bits() {
        let portable = dispatch_on(Backend::Portable, Products);
        assert!(portable.iter().collect::<std::collections::HashSet<_>>().len() > 7000);
        assert_eq!(portable.iter().filter(|&&bits| bits == u32::MAX).count(), 5);
        for (backend, n) in [(Backend::Avx2, 8), (Backend::Avx512, 8), (Backend::Avx512, 16)] {
            if backend.is_available() {
                let lanes = dispatch_for(n, backend, Products);
                assert_eq!(lanes.len(), portable.len() * n / 16);
                assert!(
                    lanes.chunks(n).eq(portable.chunks(16).map(|all| &all[..n])),
                    "{n} lanes of {backend:?}"
                );
            }
        }
        let lone: Vec<u32> = f32::compiled_for_pairs(Products);
        let first_lanes: Vec<u32> = portable.iter().copied().step_by(16).collect();
        assert_eq!(lone, first_lanes);
        // What WebAssembly does.
        assert_eq!(f32::compiled(BySums(Products)), first_lanes);
    }
}
