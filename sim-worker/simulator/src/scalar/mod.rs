//! Scalars the simulator is generic over.
//!
//! One text of the dynamics serves three purposes: `f64` is the reference, `f32` the lone single-precision twin, and the lane types
//! advance sixteen or eight environments side by side, one per lane. The lane types come in three back ends ([`Backend`]) that compute
//! **the same bits**: every operation is an IEEE operation with one rounding (fused multiply-add included), and every elementary
//! function is one polynomial written once, in [`elementary`].
//!
//! [`dispatch`] picks the back end of this processor and runs a [`LaneFn`] compiled for it:
//!
//! ```
//! use simulator::scalar::{LaneFn, Real, dispatch};
//!
//! struct Half(f64);
//! impl LaneFn for Half {
//!     type Output = f64;
//!     #[inline(always)]
//!     fn call<S: Real>(self) -> f64 {
//!         (S::splat(self.0) * S::splat(0.5)).lane(7)
//!     }
//! }
//! assert_eq!(dispatch(Half(3.0)), 1.5);
//! ```
//!
//! Everything between a [`LaneFn`] and the arithmetic must be `#[inline(always)]`: only code that is inlined into the function with the
//! processor features enabled is compiled for them.
//!
//! **Why lanes of our own.** `simba`'s need lane types that are fixed at compile time, while one binary shall use
//! AVX-512 where it is and still start on a plain x86-64. And everything on the hot path must be inlined into
//! functions compiled for the features that were found, which nalgebra's operations do not promise. nalgebra
//! builds the model and writes the readable twins.

pub mod elementary;

mod bf16;
pub(crate) mod counted;
mod double;
#[cfg(any(test, target_arch = "wasm32"))]
mod fused;
mod lanes;
mod real;
mod single;

pub(crate) use bf16::Fused;
pub use bf16::{PairProducts, WeightPair, bias as bf16_bias, round as bf16_round};
pub use lanes::{Backend, dispatch, dispatch_for, dispatch_on};
pub(crate) use lanes::{pairs_are_slow, registers_are_whole};
pub use real::{Kernel, LANES, LaneFn, Mask, PairKernel, Real, is_finite};

#[cfg(test)]
mod tests;
