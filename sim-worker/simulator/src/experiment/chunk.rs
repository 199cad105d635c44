//! The episodes that are played at once.

/// Which episodes stand in the lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    /// Seed of everything random in them.
    pub(super) seed: u64,
    /// Global index of the first.
    pub(super) first: u32,
    /// How many.
    pub(super) n_envs: usize,
}
