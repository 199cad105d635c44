//! What only the coordinator knows about an iteration.

use std::collections::BTreeMap;

use proto::Digest;

/// What only the coordinator knows about the iteration that has just ended.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Live {
    /// Time since this session of the run began (s); the reporter adds that of earlier ones.
    pub wall_s: f64,
    /// Env-steps trained on a second, of late.
    pub env_steps_per_s: f64,
    /// Workers wanted; as many live, but for those that are being replaced.
    pub workers: usize,
    /// Workers and learners replaced so far.
    pub restarts: u64,
    /// Digests of the blocks trained on, in the order of shards.
    pub blocks: Vec<Digest>,
    /// How many of them other machines have made, by their names.
    pub hosts: BTreeMap<String, u64>,
}
