//! The worker process: waits for orders, rolls out, sends, and remembers nothing.
//!
//! A worker's only state is what it was sent and can be sent again: orders not yet done, and the
//! newest policy versions. Whatever happens to it, another worker makes the same blocks.
//!
//! The floating-point environment is left as the system sets it: subnormal numbers are computed with,
//! not flushed to zero, so that every processor gives the same bits.

mod arguments;
mod assignment;
mod block;
mod evaluation;
mod fault_injection;
mod process;
mod receive;
mod start;
mod worker_loop;

pub use arguments::Arguments;
pub use start::{load, run};

#[cfg(test)]
mod tests;
