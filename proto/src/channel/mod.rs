//! Typed channels over iceoryx2, the only module that names its types.
//!
//! | channel | from → to | payload | when the receiver is full |
//! |---|---|---|---|
//! | orders | coordinator → workers, learner | [`Order`] | dropped; the coordinator's deadline re-sends |
//! | policy | learner → workers | actor parameters | newest wins, two kept for late workers |
//! | rollouts | workers → learner | a block | the worker waits, up to a deadline |
//! | progress | learner → coordinator | [`Progress`] | the learner waits, up to a deadline |
//! | status | workers → coordinator | [`Status`] | newest wins |
//! | snapshot | learner → coordinator | pieces of a training state | the learner waits, up to a deadline |
//!
//! Every send rings the receiver's bell (an iceoryx2 event), so nobody polls.
//!
//! The coordinator [creates](Channels::create) all services, everybody else [opens](Channels::open)
//! them. Everything lies in a private directory of shared memory with the [`Domain`]'s name, so several
//! users and runs share a machine without seeing each other, and what a killed run left behind can be
//! removed by name.

mod domain;
mod line;
mod ports;
mod segment;
mod sizes;
mod transport;

pub use domain::{Domain, SHARED_MEMORY};
pub use ports::{
    ArrayReceiver, ArraySample, ArraySampleMut, ArraySender, Bell, BellListener, Channels,
    MessageReceiver, MessageSender, PieceReceiver, PieceSample, PieceSender, Role,
};
pub use sizes::{ChannelSizes, PIECE_LEN};

#[cfg(doc)]
use crate::message::{Order, Progress, Status};

#[cfg(test)]
mod tests;
