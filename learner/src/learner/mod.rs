//! The learner process: receives blocks, trains, publishes policies, reports, and sends snapshots.
//!
//! Two threads: the loop's ([`run`], `learner_loop.rs`) owns all ports and keeps receiving; the other one trains. While it
//! does, blocks of the next iteration are acknowledged and late workers get their policy. `iteration.rs` is one iteration.

mod iteration;
mod learner_loop;
mod outbox;
mod ports;
mod process;
mod start;

pub use start::{Arguments, device, load, run};
