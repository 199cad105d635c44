//! A number that counts what is done with it, to know what the dynamics cost at least.

use std::cell::Cell;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use super::real::{fills_register, run_seldom};
use super::{Kernel, PairProducts, Real, WeightPair, elementary};

/// Operations that `work` does on [`Counted`] numbers: additions, multiplications, divisions and square
/// roots; comparisons, rounding and selecting are not counted.
pub(crate) fn operations(work: impl FnOnce()) -> u64 {
    OPERATIONS.set(0);
    work();
    OPERATIONS.get()
}

thread_local! {
    static OPERATIONS: Cell<u64> = const { Cell::new(0) };
}

/// A single-precision number that counts operations.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Counted(f32);

/// Not inlined: there are thousands in one function, which nobody waits for when it runs, but everybody when it is compiled.
#[inline(never)]
fn counted(operations: u64, value: f32) -> Counted {
    OPERATIONS.set(OPERATIONS.get() + operations);
    Counted(value)
}

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl $trait for Counted {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                counted(1, self.0.$method(other.0))
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl Neg for Counted {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}
impl AddAssign for Counted {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}
impl SubAssign for Counted {
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}
impl MulAssign for Counted {
    fn mul_assign(&mut self, other: Self) {
        *self = *self * other;
    }
}

impl Real for Counted {
    const LANES: usize = 1;
    type Mask = bool;
    fills_register!();
    type Pair = [Self; 2];

    fn to_bf16(self) -> Self {
        self
    }
    fn pair(first: Self, second: Self) -> [Self; 2] {
        [first, second]
    }
    fn add_pair_product<P: PairProducts>(self, x: [Self; 2], w: WeightPair, _: P) -> Self {
        let [first, second] = w.widened();
        x[0].mul_add(Self(first), x[1].mul_add(Self(second), self))
    }

    fn splat(x: f64) -> Self {
        Self(x as f32)
    }
    fn lane(self, _: usize) -> f64 {
        f64::from(self.0)
    }
    fn set_lane(&mut self, _: usize, x: f64) {
        self.0 = x as f32;
    }
    fn mul_add(self, a: Self, b: Self) -> Self {
        counted(2, f32::mul_add(self.0, a.0, b.0))
    }
    fn neg_mul_add(self, a: Self, b: Self) -> Self {
        counted(2, f32::mul_add(-self.0, a.0, b.0))
    }
    fn sqrt(self) -> Self {
        counted(1, self.0.sqrt())
    }
    fn abs(self) -> Self {
        Self(self.0.abs())
    }
    fn min(self, other: Self) -> Self {
        if self.0 < other.0 { self } else { other }
    }
    fn max(self, other: Self) -> Self {
        if self.0 > other.0 { self } else { other }
    }
    fn round(self) -> Self {
        Self(self.0.round_ties_even())
    }
    fn floor(self) -> Self {
        Self(self.0.floor())
    }
    fn lt(self, other: Self) -> bool {
        self.0 < other.0
    }
    fn le(self, other: Self) -> bool {
        self.0 <= other.0
    }
    fn select(m: bool, a: Self, b: Self) -> Self {
        if m { a } else { b }
    }
    fn copy_sign_to(self, magnitude: Self) -> Self {
        Self(magnitude.0.copysign(self.0))
    }
    fn pow2i(self) -> Self {
        Self(self.0.exp2())
    }
    fn frexp(self) -> (Self, Self) {
        let (mantissa, exponent) = self.lane(0).frexp();
        (Self(mantissa as f32), Self(exponent as f32))
    }
    fn sin_cos(self) -> (Self, Self) {
        elementary::sin_cos(self)
    }
    fn atan2(self, x: Self) -> Self {
        elementary::atan2(self, x)
    }
    fn exp(self) -> Self {
        elementary::exp(self)
    }
    fn ln(self) -> Self {
        elementary::ln(self)
    }
    fn log10(self) -> Self {
        elementary::log10(self)
    }
    fn tanh(self) -> Self {
        elementary::tanh(self)
    }

    #[inline(always)]
    fn compiled<K: Kernel<Self>>(kernel: K) -> K::Output {
        run_seldom(kernel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_counted_as_the_source_has_them() {
        let (a, b) = (Counted(3.0), Counted(4.0));
        // Two products, one of them fused with the sum; a root; comparisons are free.
        let n = operations(|| assert_eq!(a.mul_add(a, b * b).sqrt().max(a), Counted(5.0)));
        assert_eq!(n, 4);
    }
}
