//! The hub's ends of the run's channels.

use channels::{
    ArrayReceiver, ArraySender, ChannelSizes, Channels, Domain, MessageReceiver, MessageSender,
    STATUS_LEN, WHILE_THE_PARENT_LIVES,
};
use proto::config::Config;
use proto::finite::are_finite;
use proto::gateway::pieces::{Assembly, PIECE_LEN};
use proto::layout::{BlockHeader, Dimensions, PolicyHeader};
use proto::message::{self, EpisodeErrors, Order, Status, WorkerId};
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
    dimensions: Dimensions,
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
            dimensions,
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
    /// ordered, of finite numbers, and somebody took it: the learner ends where a worker of its own machine sends anything else.
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
        let numbers = sample.payload_mut();
        answer.copy_to(bytemuck::cast_slice_mut(numbers));
        if !are_finite(numbers) {
            return Ok(false);
        }
        *sample.header_mut() = BlockHeader { worker, incarnation, ..header };
        if self.blocks.send(sample)? == 0 {
            return Ok(false);
        }
        let env_steps = (self.dimensions.n_envs * self.dimensions.n_steps) as u64;
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
        let Dimensions { n_envs, n_steps, .. } = self.dimensions;
        let is_it = order.task.is_block(header.iteration, header.shard)
            && header.policy_version == order.policy_version
            && (header.n_envs as usize, header.n_steps as usize) == (n_envs, n_steps);
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
        let said = message::decode(&bytes).ok();
        let Some(status) = said.and_then(|said| answer_to(order.task, (worker, incarnation), said))
        else {
            return Ok(false);
        };
        self.say(&status)?;
        Ok(true)
    }
}

/// What a worker says of its `task`, in the name under which the coordinator knows it; none if that is no answer, or is longer than a worker of ours says it.
fn answer_to(task: Task, (worker, incarnation): (WorkerId, u32), said: Status) -> Option<Status> {
    let status = match (said, task) {
        (Status::EvaluationDone { chunk, errors, .. }, Task::Evaluation(ordered))
            if chunk == ordered =>
        {
            // None where the policy is gone or has diverged.
            let is_full = errors.is_empty() || errors.len() == chunk.episodes as usize;
            let all = errors.iter().flat_map(|EpisodeErrors { tail, min }| [tail, min]);
            let numbers = all.flat_map(|errors| [errors.position, errors.orientation, errors.base]);
            let are_finite = are_finite(&numbers.collect::<Vec<_>>());
            (is_full && are_finite).then_some(Status::EvaluationDone {
                worker,
                incarnation,
                chunk,
                errors,
            })
        }
        (Status::Failed { message, fault: Some(fault), .. }, task)
            if task.is_block(fault.iteration, fault.shard) =>
        {
            let message = message::clip(&message);
            Some(Status::Failed { worker, incarnation, message, fault: Some(fault) })
        }
        _ => None,
    };
    status.filter(|status| message::encode(status).len() <= STATUS_LEN)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proto::message::{EvaluationChunk, Fault, TaskErrors};

    use super::*;

    const NAME: (WorkerId, u32) = (1003, 2);
    const BLOCK: Task = Task::Block { iteration: 7, shard: 1 };

    fn failed(message: &str, environment: BTreeMap<String, Vec<f32>>) -> Status {
        let (iteration, shard, policy_version) = (7, 1, 7);
        let (env, step) = (Some(3), Some(4));
        let fault = Fault { iteration, shard, policy_version, env, step, environment };
        let (message, fault) = (message.to_owned(), Some(Box::new(fault)));
        Status::Failed { worker: 0, incarnation: 0, message, fault }
    }

    #[test]
    fn a_fault_is_told_in_the_name_of_the_worker_and_fits_into_the_channel() {
        let Some(Status::Failed { worker, incarnation, message, .. }) =
            answer_to(BLOCK, NAME, failed(&"x".repeat(50_000), BTreeMap::new()))
        else {
            panic!("an answer");
        };
        assert_eq!((worker, incarnation), NAME);
        assert!(message.len() < STATUS_LEN, "{}", message.len());
        let long = BTreeMap::from([("q".to_owned(), vec![0.5; 2000])]);
        assert_eq!(answer_to(BLOCK, NAME, failed("too much", long)), None);
        let other = Task::Block { iteration: 7, shard: 0 };
        assert_eq!(answer_to(other, NAME, failed("another block", BTreeMap::new())), None);
    }

    #[test]
    fn an_evaluation_has_an_entry_an_episode_or_none_and_finite_errors() {
        let chunk = EvaluationChunk { policy_version: 5, first: 16, episodes: 2 };
        let says = |errors: Vec<EpisodeErrors>| {
            let said = Status::EvaluationDone { worker: 0, incarnation: 0, chunk, errors };
            answer_to(Task::Evaluation(chunk), NAME, said).is_some()
        };
        let good = EpisodeErrors::default();
        let infinite = TaskErrors { base: f32::INFINITY, ..TaskErrors::default() };
        assert!(says(vec![good; 2]) && says(Vec::new()));
        assert!(!says(vec![good; 3]) && !says(vec![good; 1]));
        assert!(!says(vec![good, EpisodeErrors { min: infinite, ..good }]));
    }
}
