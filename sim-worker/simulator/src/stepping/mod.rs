//! Many environments that somebody outside steps: actions in, what is seen and paid out.
//!
//! A [`Batch`] is the environment of a [rollout](mod@crate::rollout) without its policy. Goals and starts have the same
//! addresses, and what happens to an environment is the same text, so the same actions make the same bits as in a
//! worker's block. Who has threads lends them, see [`crate::executor`].
//!
//! [`act()`] has a policy say what it would do in environments that were stepped so.

mod act;
mod batch;
mod chunk;
mod error;
mod rows;

pub use act::{ActError, act};
pub use batch::{Batch, Begin, GoalKind};
pub use error::StepError;
pub use rows::{ARRAYS, Rows};

#[cfg(test)]
mod tests;
