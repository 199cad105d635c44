//! The learning curves of several runs: read, put together and drawn.

mod alike;
pub mod families;
pub mod learning;
pub mod recorded;
