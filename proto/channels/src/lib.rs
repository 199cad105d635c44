//! Typed channels over iceoryx2, the only crate that names its types.
//!
//! | channel | from → to | payload | when the receiver is full |
//! |---|---|---|---|
//! | orders | coordinator → workers, learner | [`Order`] | dropped; the coordinator is told, and sends it again |
//! | policy | learner → workers | actor parameters | newest wins, two kept for late workers |
//! | rollouts | workers → learner | a block | the worker waits |
//! | progress | learner → coordinator | [`Progress`] | the learner waits |
//! | status | workers → coordinator | [`Status`] | newest wins |
//! | snapshot | learner → coordinator | pieces of a training state | the learner tries again later |
//!
//! Every send rings the receiver's bell (an iceoryx2 event), so nobody polls. Who waits for room waits
//! for as long as its parent lives ([`WHILE_THE_PARENT_LIVES`]): a coordinator that stands still, because
//! it was stopped or its disk is, comes back, and with one that is dead the kernel ends its children.
//!
//! The coordinator [creates](Channels::create) all services, everybody else [opens](Channels::open)
//! them. Everything lies in a private directory of shared memory with the [`Domain`]'s name, so several
//! users and runs share a machine without seeing each other, and what a killed run left behind can be
//! removed by name.

mod arrays;
mod backpressure;
mod bells;
mod domain;
mod error;
mod header;
mod line;
mod messages;
mod pieces;
mod place;
mod segment;
mod services;
mod sizes;
mod transport;

pub use arrays::{ArrayReceiver, ArraySample, ArraySampleMut, ArraySender};
pub use backpressure::WHILE_THE_PARENT_LIVES;
pub use bells::{Bell, BellListener, Role};
pub use domain::Domain;
pub use error::ChannelError;
pub use header::Header;
pub use messages::{MessageReceiver, MessageSender, Missed, OrderSender};
pub use pieces::{PieceReceiver, PieceSample, PieceSender};
pub use place::SHARED_MEMORY;
pub use services::Channels;
pub use sizes::{
    ChannelSizes, ORDERS_PER_WORKER, PIECE_BUFFER, PIECE_LEN, STATUS_LEN, WAITING_SNAPSHOTS,
};

#[cfg(doc)]
use proto::message::{Order, Progress, Status};

#[cfg(test)]
mod tests;
