//! Several `f32` side by side, in back ends of the same bits ([`Backend`]), and the choice among them ([`dispatch`]).

#[cfg(target_arch = "x86_64")]
#[cfg_attr(fuzzing, allow(dead_code, reason = "nobody dispatches to it"))]
mod avx2;
#[cfg(target_arch = "x86_64")]
#[cfg_attr(fuzzing, allow(dead_code, reason = "nobody dispatches to it"))]
mod avx512;
mod dispatch;
mod lone;
#[cfg(not(target_arch = "wasm32"))]
mod operators;
// An x86-64 without AVX2 runs lone numbers: each multiply-add is a call of a library there, with sixteen in plain Rust, too, which were a third of
// what compiling the simulator took.
#[cfg(all(not(target_arch = "wasm32"), any(test, not(target_arch = "x86_64"))))]
mod portable;

pub use dispatch::{Backend, dispatch, dispatch_for, dispatch_on};
pub(crate) use dispatch::{pairs_are_slow, registers_are_whole};
pub(super) use lone::run_scalar;
