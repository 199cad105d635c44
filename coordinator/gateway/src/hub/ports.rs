//! The hub's ends of the run's channels.

use channels::{
    ArrayReceiver, ArraySender, ChannelSizes, Channels, Domain, MessageReceiver, MessageSender,
    WHILE_THE_PARENT_LIVES,
};
use proto::config::Config;
use proto::gateway::pieces::{Assembly, PIECE_LEN};
use proto::layout::{BlockHeader, Dimensions, PolicyHeader};
use proto::message::{self, Order, Status};
use proto::{Digest, ExitError};

use crate::arguments::HubArguments;
use crate::arguments::joints_of;
use crate::network::Piece;
use crate::orders::{Single, Task};

/// See the module.
pub(super) struct Ports {
    pub(super) domain: Domain,
    pub(super) sizes: ChannelSizes,
    pub(super) orders: MessageReceiver<Order>,
    pub(super) policy: ArrayReceiver<PolicyHeader>,
    status: MessageSender<Status>,
    blocks: ArraySender<BlockHeader>,
    /// Env-steps of a block.
    env_steps: u64,
    // Dropped last: ports must not outlive their services.
    _channels: Channels,
}

impl Ports {
    pub(super) fn open(arguments: &HubArguments, config: &Config) -> Result<Self, ExitError> {
        let domain = Domain::parse(&arguments.domain)?;
        let dimensions = Dimensions::new(config, joints_of(&arguments.joints)?);
        let sizes = ChannelSizes::new(config, &dimensions);
        let channels = Channels::open(&domain, sizes)?;
        Ok(Self {
            domain,
            sizes,
            orders: channels.order_receiver()?,
            policy: channels.policy_receiver()?,
            status: channels.status_sender()?,
            blocks: channels.block_sender(WHILE_THE_PARENT_LIVES)?,
            env_steps: (dimensions.n_envs * dimensions.n_steps) as u64,
            _channels: channels,
        })
    }

    /// Says something to the coordinator.
    pub(super) fn say(&self, status: &Status) -> Result<(), ExitError> {
        Ok(self.status.send(status)?)
    }

    /// Longest answer to an order (bytes).
    pub(super) fn longest_answer(&self) -> usize {
        (4 * self.sizes.block_len).max(PIECE_LEN)
    }

    /// Gives a block to the learner, copied once from where the network put it. Whether it was the one that was
    /// ordered, and somebody took it.
    pub(super) fn block(
        &self,
        order: &Single,
        header: &[u8],
        answer: &Assembly<Piece>,
        len: usize,
    ) -> Result<bool, ExitError> {
        let Some(header) = self.ordered(order, header, len) else { return Ok(false) };
        let BlockHeader { iteration, shard, rollout_ns, .. } = header;
        let (worker, incarnation) = (order.worker, order.incarnation);
        let mut sample = self.blocks.loan()?;
        answer.copy_to(bytemuck::cast_slice_mut(sample.payload_mut()));
        *sample.header_mut() = BlockHeader { worker, incarnation, ..header };
        if self.blocks.send(sample)? == 0 {
            return Ok(false);
        }
        let env_steps = self.env_steps;
        let done =
            Status::BlockDone { worker, incarnation, iteration, shard, env_steps, rollout_ns };
        self.say(&done)?;
        Ok(true)
    }

    /// Says to the coordinator what a block is that is for comparison alone. Whether it was the one that was ordered.
    pub(super) fn audited(
        &self,
        order: &Single,
        header: &[u8],
        answer: &Assembly<Piece>,
        len: usize,
    ) -> Result<bool, ExitError> {
        let Some(header) = self.ordered(order, header, len) else { return Ok(false) };
        let BlockHeader { iteration, shard, .. } = header;
        let mut numbers = vec![0.0_f32; self.sizes.block_len];
        answer.copy_to(bytemuck::cast_slice_mut(&mut numbers));
        let digest = Digest::of_block(&numbers);
        let (worker, incarnation) = (order.worker, order.incarnation);
        self.say(&Status::Audited { worker, incarnation, iteration, shard, digest })?;
        Ok(true)
    }

    /// The header of an answer of `len` bytes, if it is the block that was ordered.
    fn ordered(&self, order: &Single, header: &[u8], len: usize) -> Option<BlockHeader> {
        let header = bytemuck::try_pod_read_unaligned::<BlockHeader>(header).ok()?;
        let is_it = order.task.is_block(header.iteration, header.shard);
        (is_it && len == 4 * self.sizes.block_len).then_some(header)
    }

    /// Says to the coordinator what a worker has said. Whether it belongs to what was ordered.
    pub(super) fn status(
        &self,
        order: &Single,
        answer: &Assembly<Piece>,
        len: usize,
    ) -> Result<bool, ExitError> {
        let mut bytes = vec![0; len];
        answer.copy_to(&mut bytes);
        let (worker, incarnation) = (order.worker, order.incarnation);
        let status = match (message::decode(&bytes), order.task) {
            (Ok(Status::EvaluationDone { chunk, errors, .. }), Task::Evaluation(ordered))
                if chunk == ordered =>
            {
                Status::EvaluationDone { worker, incarnation, chunk, errors }
            }
            (Ok(Status::Failed { message, fault: Some(fault), .. }), task)
                if task.is_block(fault.iteration, fault.shard) =>
            {
                Status::Failed { worker, incarnation, message, fault: Some(fault) }
            }
            _ => return Ok(false),
        };
        self.say(&status)?;
        Ok(true)
    }
}
