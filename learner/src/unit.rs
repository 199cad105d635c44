//! What hidden units make of their inputs: ReLU and ELU, forward and backward.

use crate::lanes::{Lanes, ROUND};

/// What a hidden unit makes of its input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// max(x, 0).
    Relu,
    /// x above zero, eˣ − 1 below [Clevert, Unterthiner and Hochreiter 2016].
    Elu,
}

/// A [`Unit`] with its constants, as passes are compiled for it.
pub(crate) trait Nonlinearity<L: Lanes>: Copy {
    fn new(can: L::Can) -> Self;
    fn of<const FMA: bool>(self, x: L) -> L;
    /// The gradient by x from that by what became of it.
    fn back<const FMA: bool>(self, x: L, d: L) -> L;
    /// The same where x is not at hand, but `y`, what became of it.
    fn back_from_result(self, y: L, d: L) -> L;
}

#[derive(Clone, Copy)]
pub(crate) struct Relu<L> {
    zero: L,
}

impl<L: Lanes> Nonlinearity<L> for Relu<L> {
    #[inline(always)]
    fn new(can: L::Can) -> Self {
        Self { zero: L::constant(can, 0.0) }
    }
    #[inline(always)]
    fn of<const FMA: bool>(self, x: L) -> L {
        x.if_positive(x, self.zero)
    }
    #[inline(always)]
    fn back<const FMA: bool>(self, x: L, d: L) -> L {
        x.if_positive(d, self.zero)
    }
    #[inline(always)]
    fn back_from_result(self, y: L, d: L) -> L {
        y.if_positive(d, self.zero)
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Elu<L> {
    one: L,
    minus_one: L,
    exponential: Exponential<L>,
}

impl<L: Lanes> Nonlinearity<L> for Elu<L> {
    #[inline(always)]
    fn new(can: L::Can) -> Self {
        let [one, minus_one] = [L::constant(can, 1.0), L::constant(can, -1.0)];
        Self { one, minus_one, exponential: Exponential::new(can) }
    }
    #[inline(always)]
    fn of<const FMA: bool>(self, x: L) -> L {
        x.if_positive(x, self.exponential.of_negative::<FMA>(x).plus(self.minus_one))
    }
    #[inline(always)]
    fn back<const FMA: bool>(self, x: L, d: L) -> L {
        x.if_positive(d, d.times(self.exponential.of_negative::<FMA>(x)))
    }
    /// eˣ is y + 1, without another exponential.
    #[inline(always)]
    fn back_from_result(self, y: L, d: L) -> L {
        y.if_positive(d, d.times(y.plus(self.one)))
    }
}

/// The constants of an exponential.
#[derive(Clone, Copy)]
struct Exponential<L> {
    least: L,
    log2_e: L,
    round: L,
    minus_round: L,
    minus_ln_2: [L; 2],
    /// Of the Taylor series, from the first power to the seventh.
    series: [L; 7],
}

impl<L: Lanes> Exponential<L> {
    #[inline(always)]
    fn new(can: L::Can) -> Self {
        let c = |x| L::constant(can, x);
        Self {
            // Below, eˣ is no normal number.
            least: c(-87.0),
            log2_e: c(std::f32::consts::LOG2_E),
            round: c(ROUND),
            minus_round: c(-ROUND),
            // In two parts, the first of so few digits that n times it is exact.
            minus_ln_2: [c(-0.693_359_4), c(2.121_944_4e-4)],
            series: [
                c(1.0),
                c(0.5),
                c(1.0 / 6.0),
                c(1.0 / 24.0),
                c(1.0 / 120.0),
                c(1.0 / 720.0),
                c(1.0 / 5040.0),
            ],
        }
    }

    /// eˣ for x ≤ 0, within 2⁻²³; anything above. NaN gives NaN.
    ///
    /// x = n ln 2 + r with |r| ≤ ½ ln 2, and the Taylor series of eʳ to r⁷, whose rest is below 2⁻²⁷, by Estrin's scheme: half as many steps wait for one
    /// another as in Horner's.
    #[inline(always)]
    fn of_negative<const FMA: bool>(self, x: L) -> L {
        let [c1, c2, c3, c4, c5, c6, c7] = self.series;
        let x = x.at_least(self.least);
        let rounded = x.mul_add::<FMA>(self.log2_e, self.round);
        let n = rounded.plus(self.minus_round);
        let r = n.mul_add::<FMA>(self.minus_ln_2[0], x);
        let r = n.mul_add::<FMA>(self.minus_ln_2[1], r);
        let r2 = r.times(r);
        let to_1 = r.plus(c1);
        let to_3 = r.mul_add::<FMA>(c3, c2);
        let to_5 = r.mul_add::<FMA>(c5, c4);
        let to_7 = r.mul_add::<FMA>(c7, c6);
        let low = to_3.mul_add::<FMA>(r2, to_1);
        let high = to_7.mul_add::<FMA>(r2, to_5);
        let sum = high.mul_add::<FMA>(r2.times(r2), low);
        sum.times_power_of_two(n, rounded)
    }
}

#[cfg(test)]
impl Unit {
    /// What becomes of `x`, as loops compiled for this processor have it.
    pub(crate) fn of(self, x: f32) -> f32 {
        match (self, crate::features::Features::detect()) {
            (Self::Relu, _) => Relu::new(()).of::<false>(x),
            (Self::Elu, crate::features::Features::Any) => Elu::new(()).of::<false>(x),
            (Self::Elu, _) => Elu::new(()).of::<true>(x),
        }
    }

    /// The gradient `d` before the unit, from what became of it.
    pub(crate) fn back_from_result(self, y: f32, d: f32) -> f32 {
        match self {
            Self::Relu => Relu::new(()).back_from_result(y, d),
            Self::Elu => Elu::new(()).back_from_result(y, d),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// To the bit, for numbers of all sizes: with fewer digits and with many, infinite ones and NaN.
    #[cfg(target_arch = "x86_64")]
    #[expect(unsafe_code, reason = "instructions of detected processor features")]
    #[test]
    fn registers_hold_what_numbers_become_one_by_one() {
        use std::arch::x86_64::__m512;
        use std::mem::transmute;

        use crate::features::Features;
        use crate::lanes::{Avx512, Registers};

        #[target_feature(enable = "avx512f")]
        fn in_registers(x: [f32; 32]) -> [[f32; 32]; 4] {
            // SAFETY: compiled for AVX-512; arrays of numbers are of one size with registers, and every bit pattern is a value of both.
            unsafe {
                let can = Avx512::new();
                let x = Registers::new(can, transmute::<[f32; 32], [__m512; 2]>(x));
                let made = [
                    Relu::new(can).of::<true>(x),
                    Elu::new(can).of::<true>(x),
                    Relu::new(can).back_from_result(x, x),
                    Elu::new(can).back_from_result(x, x),
                ];
                made.map(|registers| transmute::<[__m512; 2], [f32; 32]>(registers.get()))
            }
        }

        if !matches!(Features::detect(), Features::Avx512(_) | Features::Avx512Bf16(_)) {
            return;
        }
        for (start, digits) in (0..1 << 16).step_by(32).flat_map(|i| [(i, 0), (i, 0x9e37)]) {
            let x: [f32; 32] =
                std::array::from_fn(|i| f32::from_bits((start + i as u32) << 16 | digits));
            // SAFETY: just asked for.
            let found = unsafe { in_registers(x) };
            for (i, x) in x.into_iter().enumerate() {
                let expected = [
                    Relu::new(()).of::<true>(x),
                    Elu::new(()).of::<true>(x),
                    Relu::new(()).back_from_result(x, x),
                    Elu::new(()).back_from_result(x, x),
                ];
                for (found, expected) in found.iter().zip(expected) {
                    let same = found[i].to_bits() == expected.to_bits();
                    assert!(same || found[i].is_nan() && expected.is_nan(), "{x}: {}", found[i]);
                }
            }
        }
    }

    #[test]
    fn the_exponential_is_that_of_the_standard_library() {
        let exponential = Exponential::<f32>::new(());
        for i in 0..87_000 {
            let x = -(i as f32) * 1e-3;
            let exact = f64::from(x).exp();
            for found in [exponential.of_negative::<true>(x), exponential.of_negative::<false>(x)] {
                let error = (f64::from(found) / exact - 1.0).abs();
                assert!(error < 2.0 * f64::from(f32::EPSILON), "{x}: {found}, {exact}");
            }
        }
        assert!(exponential.of_negative::<true>(-1e9) < 1e-37);
        assert!(exponential.of_negative::<true>(f32::NAN).is_nan());
    }
}
