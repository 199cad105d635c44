//! The ports of a learner, and what comes and goes through them.

use std::time::{Duration, Instant};

use channels::{
    ArrayReceiver, ArraySample, ArraySender, BellListener, ChannelSizes, Channels, Domain,
    MessageReceiver, MessageSender, PieceSender, Role, WHILE_THE_PARENT_LIVES,
};
use proto::Digest;
use proto::config::Config;
use proto::layout::{BlockHeader, Dimensions, PolicyHeader};
use proto::message::{HEARTBEAT, Order, Progress};

use super::outbox::Outbox;
use crate::LearnerError;
use crate::inbox::{Inbox, Receipt};

/// How long a piece of a snapshot waits for room before it is tried again later.
const PIECE_DEADLINE: Duration = Duration::from_millis(1);

/// Ports and what has come in through them. iceoryx2's ports stay on one thread.
pub(super) struct Ports {
    pub(super) inbox: Inbox<ArraySample<BlockHeader>>,
    /// Snapshots on their way.
    pub(super) outbox: Outbox,
    heartbeat: Instant,
    pub(super) wants_snapshot: bool,
    pub(super) wants_stop: bool,
    pub(super) orders: MessageReceiver<Order>,
    pub(super) blocks: ArrayReceiver<BlockHeader>,
    pub(super) policy: ArraySender<PolicyHeader>,
    pub(super) progress: MessageSender<Progress>,
    pub(super) snapshot: PieceSender,
    pub(super) bell: BellListener,
    // Dropped last: ports must not outlive their services.
    _channels: Channels,
}

impl Ports {
    pub(super) fn open(
        domain: &str,
        config: &Config,
        dimensions: &Dimensions,
        iteration: u64,
    ) -> Result<Self, LearnerError> {
        let domain = Domain::parse(domain)?;
        let channels = Channels::open(&domain, ChannelSizes::new(config, dimensions))?;
        Ok(Self {
            inbox: Inbox::new(config, dimensions, iteration),
            outbox: Outbox::default(),
            heartbeat: Instant::now(),
            wants_snapshot: false,
            wants_stop: false,
            orders: channels.order_receiver()?,
            blocks: channels.block_receiver()?,
            policy: channels.policy_sender()?,
            progress: channels.progress_sender(WHILE_THE_PARENT_LIVES)?,
            snapshot: channels.snapshot_sender(PIECE_DEADLINE)?,
            bell: channels.listener(Role::Learner)?,
            _channels: channels,
        })
    }

    /// Takes in whatever has arrived.
    pub(super) fn pump(&mut self) -> Result<(), LearnerError> {
        self.policy.update_connections();
        while let Some(order) = self.orders.try_receive()? {
            match order {
                Order::Snapshot => self.wants_snapshot = true,
                Order::Stop(_) => self.wants_stop = true,
                Order::Discard { host, gateway } => {
                    for (iteration, shard) in self.inbox.discard(gateway, host) {
                        self.progress.send(&Progress::BlockDiscarded { iteration, shard })?;
                    }
                }
                _ => {}
            }
        }
        while let Some(block) = self.blocks.try_receive()? {
            let BlockHeader { iteration, shard, worker, incarnation, .. } = *block.header();
            let digest = Digest::of_block(block.payload());
            let duplicate = match self.inbox.receive(block)? {
                Receipt::Fresh => false,
                Receipt::Duplicate => true,
                Receipt::Unwanted => continue,
            };
            self.progress.send(&Progress::BlockReceived {
                iteration,
                shard,
                worker,
                incarnation,
                duplicate,
                digest,
            })?;
        }
        let Self { outbox, snapshot, .. } = self;
        Ok(outbox.send(|header, bytes| snapshot.send(header, bytes))?)
    }

    /// Says once in a while that the process is alive.
    pub(super) fn beat(&mut self) -> Result<(), LearnerError> {
        if self.heartbeat.elapsed() >= HEARTBEAT {
            self.heartbeat = Instant::now();
            self.progress.send(&Progress::Heartbeat)?;
        }
        Ok(())
    }

    /// Publishes a policy that `write` fills in, in shared memory.
    pub(super) fn publish(
        &self,
        version: u64,
        write: impl FnOnce(&mut [f32]),
    ) -> Result<(), LearnerError> {
        let mut sample = self.policy.loan()?;
        write(sample.payload_mut());
        *sample.header_mut() = PolicyHeader { version };
        self.policy.send(sample)?;
        Ok(())
    }
}
