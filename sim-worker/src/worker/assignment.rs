//! What there is to do.

use proto::message::EvaluationChunk;

/// One block to be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Block {
    pub(super) iteration: u64,
    pub(super) policy_version: u64,
    pub(super) shard: u32,
}

/// A block to make, or episodes to play.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Assignment {
    Rollout(Block),
    Evaluation(EvaluationChunk),
}

impl Assignment {
    /// The version that it is done with.
    pub(super) fn policy_version(&self) -> u64 {
        match self {
            Self::Rollout(block) => block.policy_version,
            Self::Evaluation(chunk) => chunk.policy_version,
        }
    }
}
