//! What hidden units make of their inputs: ReLU and ELU, forward and backward.

use crate::features::mul_add;

/// What a hidden unit makes of its input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// max(x, 0).
    Relu,
    /// x above zero, eˣ − 1 below [Clevert, Unterthiner and Hochreiter 2016].
    Elu,
}

/// [`Unit`] as the passes are compiled for it.
pub(super) trait Nonlinearity {
    fn of<const FMA: bool>(self, x: f32) -> f32;
    /// The gradient by x from that by what became of it.
    fn back<const FMA: bool>(self, x: f32, d: f32) -> f32;
    /// The same where x is not at hand, but `y`, what became of it.
    fn back_from_result(self, y: f32, d: f32) -> f32;
}

#[derive(Clone, Copy)]
pub(super) struct Relu;

impl Nonlinearity for Relu {
    #[inline(always)]
    fn of<const FMA: bool>(self, x: f32) -> f32 {
        if x > 0.0 { x } else { 0.0 }
    }
    #[inline(always)]
    fn back<const FMA: bool>(self, x: f32, d: f32) -> f32 {
        if x > 0.0 { d } else { 0.0 }
    }
    #[inline(always)]
    fn back_from_result(self, y: f32, d: f32) -> f32 {
        if y > 0.0 { d } else { 0.0 }
    }
}

#[derive(Clone, Copy)]
pub(super) struct Elu;

impl Nonlinearity for Elu {
    #[inline(always)]
    fn of<const FMA: bool>(self, x: f32) -> f32 {
        let below = exp_of_negative::<FMA>(x) - 1.0;
        if x > 0.0 { x } else { below }
    }
    #[inline(always)]
    fn back<const FMA: bool>(self, x: f32, d: f32) -> f32 {
        let below = d * exp_of_negative::<FMA>(x);
        if x > 0.0 { d } else { below }
    }
    /// eˣ is y + 1, without another exponential.
    #[inline(always)]
    fn back_from_result(self, y: f32, d: f32) -> f32 {
        let below = d * (y + 1.0);
        if y > 0.0 { d } else { below }
    }
}

/// eˣ for x ≤ 0, within 2⁻²³; 1 above. NaN gives NaN.
///
/// x = n ln 2 + r with |r| ≤ ½ ln 2, and the Taylor series of eʳ to r⁷, whose rest is below 2⁻²⁷, by Estrin's scheme: half as many steps wait for one
/// another as in Horner's.
#[inline(always)]
fn exp_of_negative<const FMA: bool>(x: f32) -> f32 {
    /// 1.5 · 2²³: sums with it have no digits behind the point.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts, the first of so few digits that n times it is exact.
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    // Below, eˣ is no normal number.
    let x = if x > 0.0 { 0.0 } else { x };
    let x = if x < -87.0 { -87.0 } else { x };
    let n = mul_add::<FMA>(x, std::f32::consts::LOG2_E, ROUND) - ROUND;
    let r = mul_add::<FMA>(n, -LN_2_LOW, mul_add::<FMA>(n, -LN_2_HIGH, x));
    let r2 = r * r;
    let to_1 = r + 1.0;
    let to_3 = mul_add::<FMA>(r, 1.0 / 6.0, 0.5);
    let to_5 = mul_add::<FMA>(r, 1.0 / 120.0, 1.0 / 24.0);
    let to_7 = mul_add::<FMA>(r, 1.0 / 5040.0, 1.0 / 720.0);
    let (low, high) = (mul_add::<FMA>(to_3, r2, to_1), mul_add::<FMA>(to_7, r2, to_5));
    let sum = mul_add::<FMA>(high, r2 * r2, low);
    // 2ⁿ, −126 ≤ n ≤ 0, by its exponent; whole numbers below 2²³ stand in the lower bits of a sum with ROUND.
    let exponent = (n + ROUND).to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127);
    sum * f32::from_bits(exponent << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_that_of_the_standard_library() {
        for i in 0..87_000 {
            let x = -(i as f32) * 1e-3;
            let exact = f64::from(x).exp();
            for found in [exp_of_negative::<true>(x), exp_of_negative::<false>(x)] {
                let error = (f64::from(found) / exact - 1.0).abs();
                assert!(error < 2.0 * f64::from(f32::EPSILON), "{x}: {found}, {exact}");
            }
        }
        assert_eq!(exp_of_negative::<true>(3.0), 1.0);
        assert!(exp_of_negative::<true>(-1e9) < 1e-37);
        assert!(exp_of_negative::<true>(f32::NAN).is_nan());
    }
}
