//! A fused multiply-add in single precision for processors that have none to offer: WebAssembly's.
//!
//! The C library's way is exact and slow. Here the product of two `f32` is exact in `f64`, and the sum is rounded
//! there once. Rounding that to `f32` is rounding twice, which goes wrong only where the first result lies in the
//! middle between two `f32`: on a tie, or anywhere below the normal numbers, whose middles are elsewhere. There the first
//! rounding is made one to odd, after which a second one is harmless [Boldo and Melquiond 2008, Emulation of FMA and correctly
//! rounded sums: proved algorithms using rounding to odd].

/// `x · y + z` with one rounding, as [`f32::mul_add`] has it.
///
/// A call, because the dynamics have thousands in one function, and browsers take seconds to compile what that would become.
#[inline(never)]
pub(super) fn mul_add(x: f32, y: f32, z: f32) -> f32 {
    inlined(x, y, z)
}

/// [`mul_add`] in place, for loops.
#[inline(always)]
pub(super) fn inlined(x: f32, y: f32, z: f32) -> f32 {
    // Half of the last digit that an f32 keeps of an f64.
    const TIE: u64 = 1 << 28;
    let product = f64::from(x) * f64::from(y);
    let sum = product + f64::from(z);
    let bits = sum.to_bits();
    let exponent = bits >> 52 & 0x7ff;
    // 897 is that of the smallest normal f32; zero is exact.
    if bits & (2 * TIE - 1) == TIE || exponent < 897 && sum != 0.0 {
        return rounded_to_odd(product, f64::from(z), sum) as f32;
    }
    sum as f32
}

/// `a + b` rounded to odd: the one of its two neighbours in `f64` whose last digit is one, unless it is a number itself. `sum` is the nearest.
///
/// Neither overflows: both come from `f32`.
#[cold]
#[inline(never)]
fn rounded_to_odd(a: f64, b: f64, sum: f64) -> f64 {
    // What was rounded away, exactly [Knuth, TwoSum].
    let of_b = sum - a;
    let error = (a - (sum - of_b)) + (b - of_b);
    let bits = sum.to_bits();
    if error == 0.0 || bits & 1 == 1 {
        return sum;
    }
    // Away from zero where the error has the sign of the sum.
    f64::from_bits(if (error > 0.0) == (sum > 0.0) { bits + 1 } else { bits - 1 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agrees(x: f32, y: f32, z: f32) {
        let (ours, exact) = (mul_add(x, y, z), x.mul_add(y, z));
        let same = ours.to_bits() == exact.to_bits() || ours.is_nan() && exact.is_nan();
        assert!(same, "{x:e} · {y:e} + {z:e}: {ours:e}, {exact:e} is right");
    }

    /// Uniform 32-bit words: Marsaglia's xorshift.
    fn words() -> impl FnMut() -> u32 {
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 32) as u32
        }
    }

    #[test]
    fn any_bits_are_multiplied_and_added_with_one_rounding() {
        let mut word = words();
        for _ in 0..400_000 {
            // Of any kind, subnormal, infinite, no number.
            let [x, y, z] = [word(), word(), word()].map(f32::from_bits);
            agrees(x, y, z);
            // Product and sum of one size, where digits meet.
            let size =
                |word: u32, exponent: u32| f32::from_bits(word & 0x807f_ffff | exponent << 23);
            let exponent = 100 + word() % 54;
            let [x, y] = [size(word(), exponent), size(word(), 254 - exponent)];
            agrees(x, y, size(word(), 120 + word() % 14));
            // Small ones, whose sum is subnormal or just not.
            let [x, y] = [size(word(), 60 + word() % 10), size(word(), 60 + word() % 10)];
            agrees(x, y, size(word(), word() % 12));
        }
    }

    /// Halfway between two numbers but for something much smaller, which decides.
    #[test]
    fn ties_and_all_but_ties_go_where_they_belong() {
        let mut word = words();
        let tiny = [0.0, 1e-30, -1e-30, 1e-9, -1e-9, f32::MIN_POSITIVE, 1e-45, -1e-45];
        for _ in 0..100_000 {
            // Thirteen digits times twelve are twenty-five: a tie, if the last one is odd.
            let (x, y) = ((word() >> 19 | 0x1001) as f32, (word() >> 20 | 0x801) as f32);
            let scale = ((word() % 200) as f32 - 150.0).exp2();
            for z in tiny {
                agrees(x * scale, y, z);
                agrees(-x * scale, y, z);
            }
            // The small part is the product.
            let z = f32::from_bits(word() & 0x807f_ffff | 127 << 23);
            for ulps in [0.5_f32, 1.5, -0.5, 0.25] {
                for nearly in [1.0, 1.0 + f32::EPSILON, 1.0 - f32::EPSILON / 2.0] {
                    agrees(ulps * f32::EPSILON, nearly, z);
                    agrees(ulps * f32::EPSILON / 2.0, nearly, z);
                }
            }
        }
    }

    #[test]
    fn the_edges_are_those_of_the_standard() {
        let edges = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            f32::MAX,
            f32::MIN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::NAN,
            f32::MIN_POSITIVE,
            1e-45,
            -1e-45,
            1.1754942e-38,
            0.5,
            1.0 + f32::EPSILON,
            16_777_217.0,
            1.8446744e19,
            9.223372e18,
            -1.8446744e19,
        ];
        for x in edges {
            for y in edges {
                for z in edges {
                    agrees(x, y, z);
                }
            }
        }
    }
}
