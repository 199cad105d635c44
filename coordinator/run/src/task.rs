//! What a worker can be ordered to do.

use proto::message::EvaluationChunk;

/// Iteration and shard: the address of a block.
pub type ShardAddress = (u64, u32);

/// What a worker can be ordered to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Make a block.
    Rollout(ShardAddress),
    /// Make a block for comparison: it is open all the same.
    Audit(ShardAddress),
    /// Play episodes of an evaluation.
    Evaluation(EvaluationChunk),
}

impl std::fmt::Display for Task {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Rollout((iteration, shard)) => write!(f, "{iteration}/{shard}"),
            Self::Audit((iteration, shard)) => write!(f, "audit {iteration}/{shard}"),
            Self::Evaluation(chunk) => write!(f, "evaluation {}", chunk.policy_version),
        }
    }
}
