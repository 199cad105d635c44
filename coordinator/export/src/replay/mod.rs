//! What was kept, played again: at which step, if any, a bit differs.

mod block;
mod comparison;
mod motion;

pub use self::block::{BlockStart, block_start, replay_block};
pub use self::comparison::{Difference, Replay};
pub use self::motion::replay_motion;

#[cfg(test)]
mod tests;
