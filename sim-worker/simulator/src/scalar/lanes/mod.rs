//! Several `f32` side by side, in back ends of the same bits ([`Backend`]), and the choice among them ([`dispatch`]).

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod dispatch;
mod lone;
#[cfg(not(target_arch = "wasm32"))]
mod operators;
#[cfg(not(target_arch = "wasm32"))]
mod portable;

pub use dispatch::{Backend, dispatch, dispatch_for, dispatch_on};
pub(super) use lone::run_scalar;
