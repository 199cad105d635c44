//! The `octopus` command: one file a command. What commands do with runs, stores and policies is in the
//! crates below: `lab`, `run`, `service`, `store`.
//!
//! It links no libtorch and starts in milliseconds.

pub mod cli;
pub mod commands;

pub mod limits;
pub mod logs;
