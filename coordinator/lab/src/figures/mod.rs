//! The learning curves of several runs: read, put together and drawn.

pub mod families;
pub mod learning;
pub mod recorded;
