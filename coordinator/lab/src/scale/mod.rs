//! How far a training grows beyond one machine: `octopus bench scale`, on paper.
//!
//! A discrete-event simulation of a run with many hosts and of a learner that is divided by agents, from times that were
//! measured:
//!
//! * [`Costs`]: what a block, an update and a policy take;
//! * [`Machines`]: how many machines of what kind, and their network;
//! * [`simulate`]: what happens then, as scheduler, workers, gateways and learner would do it;
//! * [`study`]: many sizes side by side, and what holds each of them back.

mod event;
mod machines;
mod server;
mod simulate;
mod study;

pub use machines::{Costs, Machines};
pub use simulate::{Outcome, simulate};
pub use study::{Limit, Row, Scale, study, table, to_json};
