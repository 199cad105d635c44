//! How large the channels are, and how much shared memory they take.

use proto::config::Config;
use proto::layout::{ActorLayout, BlockLayout, Dimensions};

use crate::segment::MARGIN;

/// Longest piece of a snapshot (bytes).
pub const PIECE_LEN: usize = 4 << 20;
/// Pieces of a snapshot that may wait.
pub const PIECE_BUFFER: usize = 4;
/// Memory that whole snapshots which wait may take (bytes), before they are sent and before they are written.
pub const WAITING_SNAPSHOTS: usize = 256 << 20;

/// Fixed sizes of a run's channels. Created once, equal in every process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChannelSizes {
    /// Workers that may be connected at once: twice those wanted, because a replacement may
    /// connect before its predecessor is cleaned up, and a live run may be scaled up.
    pub max_workers: usize,
    /// Length of a block (`f32`).
    pub block_len: usize,
    /// Length of a policy (`f32`).
    pub policy_len: usize,
    /// Orders that may wait in a receiver's queue: every receiver gets those of all.
    pub order_buffer: usize,
    /// Blocks of one worker that may wait in the learner's queue.
    pub block_buffer: usize,
    /// Blocks that the learner may hold: two iterations, one trained on, one arriving.
    pub block_borrowed: usize,
}

/// Orders that a worker may have at once: one that it works on, one that waits, so that it never
/// idles for the length of a message.
pub const ORDERS_PER_WORKER: usize = 2;

/// Messages that may wait in a receiver's queue.
pub(crate) const MESSAGE_BUFFER: usize = 64;
/// Longest encoded order (bytes); one shard or one part of an evaluation takes less than 50.
pub(crate) const ORDER_LEN: usize = 256;
/// Receivers that may stand still, each at another time, with orders in their queues that nobody else has any
/// more; see [`ChannelSizes::order_slots`].
const STANDING_STILL: usize = 16;
/// Longest encoded status (bytes).
pub const STATUS_LEN: usize = 4 << 10;
/// Longest encoded progress (bytes).
pub(crate) const PROGRESS_LEN: usize = 16 << 10;
/// Policies that may wait, and that a late worker still gets.
pub(crate) const POLICY_BUFFER: usize = 2;
/// Policies that the coordinator may hold: two and one that it has just received. A worker holds one,
/// while it reads it.
pub(crate) const POLICY_BORROWED: usize = 3;
/// Services, connections and what must stay free (bytes): an allowance, which a test compares with what
/// is taken.
const MANAGEMENT: u64 = (3 << 20) + MARGIN;

impl ChannelSizes {
    /// The sizes for a configuration on a robot with `dimensions`.
    pub fn new(config: &Config, dimensions: &Dimensions) -> Self {
        let max_workers = Self::most_workers(config.run.workers);
        Self {
            max_workers,
            // When an iteration begins, all workers are sent their fill before any of them has read.
            order_buffer: (ORDERS_PER_WORKER * max_workers).max(MESSAGE_BUFFER),
            block_len: BlockLayout::new(dimensions).len,
            policy_len: ActorLayout::new(config, dimensions).len,
            block_buffer: dimensions.n_shards,
            block_borrowed: 2 * dimensions.n_shards + 1,
        }
    }

    /// How many workers may be connected at once where `workers` were wanted at the start.
    pub fn most_workers(workers: usize) -> usize {
        (2 * workers).max(16)
    }

    /// Policies that exist at once, at most. All receivers' queues hold the same, the newest; beside them
    /// there are the one that is written, the one that it pushes out, what the coordinator holds, and
    /// one for every worker that stands still while it reads. iceoryx2 would reckon with queues of which
    /// each holds others, and reserve four times as much.
    pub(crate) fn policy_slots(&self) -> usize {
        POLICY_BUFFER + 2 + POLICY_BORROWED + self.max_workers
    }

    /// Orders that exist at once, at most. Who reads its queue now and then holds what was sent since, and
    /// that is the same for all of them; only who stands still keeps others. iceoryx2 would reckon with queues
    /// of which each holds others, which grows with the square of the workers. Where all slots are taken all the
    /// same an order is missed by all, and sent again when there is room.
    pub(crate) fn order_slots(&self) -> usize {
        let worst = (self.max_workers + 3) * (self.order_buffer + 1) + 1;
        worst.min(STANDING_STILL * self.order_buffer)
    }

    /// What one receiver's connection takes (bytes): a mark for each slot, and a place of its queue there
    /// and back.
    fn order_connection(&self) -> u64 {
        (self.order_slots() + 32 * self.order_buffer) as u64
    }

    /// Shared memory that `workers` workers, the learner and the coordinator reserve, by channel
    /// (bytes). Each sender has as many slots as all receivers can queue and hold, plus its history and
    /// the ones it fills; of policies see `policy_slots`, of orders `order_slots`.
    pub fn shared_memory(&self, workers: usize) -> [(&'static str, u64); 4] {
        let bytes = |slots: usize, len: usize| (slots * (len + 256)) as u64;
        let blocks = bytes(self.block_buffer + self.block_borrowed + 1, 4 * self.block_len);
        let messages =
            |receivers: usize, buffer: usize, len: usize| bytes(receivers * (buffer + 1) + 1, len);
        let orders =
            bytes(self.order_slots(), ORDER_LEN) + (workers as u64 + 1) * self.order_connection();
        let reports = messages(2, MESSAGE_BUFFER, PROGRESS_LEN)
            + workers as u64 * messages(2, MESSAGE_BUFFER, STATUS_LEN);
        [
            ("rollouts", blocks * workers as u64),
            ("policy", bytes(self.policy_slots(), 4 * self.policy_len)),
            ("snapshot", bytes(PIECE_BUFFER + 2, PIECE_LEN)),
            ("messages", orders + reports + MANAGEMENT),
        ]
    }
}
