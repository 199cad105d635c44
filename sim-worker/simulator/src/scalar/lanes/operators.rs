//! What the back ends have in common: masks of one bit a lane, and the operators that follow from a few basic operations.

use std::ops::{BitAnd, BitOr, Not};

use crate::scalar::Mask;

/// A mask with a bit per lane.
macro_rules! bit_mask {
    ($mask:ident, $bits:ident) => {
        /// One bit per lane.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) struct $mask(pub(super) $bits);

        impl BitAnd for $mask {
            type Output = Self;
            #[inline(always)]
            fn bitand(self, other: Self) -> Self {
                Self(self.0 & other.0)
            }
        }
        impl BitOr for $mask {
            type Output = Self;
            #[inline(always)]
            fn bitor(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }
        }
        impl Not for $mask {
            type Output = Self;
            #[inline(always)]
            fn not(self) -> Self {
                Self(!self.0)
            }
        }
        impl Mask for $mask {
            #[inline(always)]
            fn splat(value: bool) -> Self {
                Self(if value { $bits::MAX } else { 0 })
            }
            #[inline(always)]
            fn any(self) -> bool {
                self.0 != 0
            }
            #[inline(always)]
            fn all(self) -> bool {
                self.0 == $bits::MAX
            }
            #[inline(always)]
            fn lane(self, i: usize) -> bool {
                self.0 >> i & 1 == 1
            }
            #[inline(always)]
            fn set_lane(&mut self, i: usize, value: bool) {
                self.0 = self.0 & !(1 << i) | $bits::from(value) << i;
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
pub(super) use bit_mask;

bit_mask!(Mask16, u16);

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

pub(super) use derive_operators;

/// A binary operator of an intrinsic type.
#[cfg(target_arch = "x86_64")]
macro_rules! operator {
    ($t:ident, $trait:ident, $f:ident, |$a:ident, $b:ident| $e:expr) => {
        impl $trait for $t {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                // SAFETY: values of this type exist only once `dispatch_on` or `dispatch_for` has found the processor features.
                unsafe { $e }
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
pub(super) use operator;
