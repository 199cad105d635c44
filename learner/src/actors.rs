//! Which actors are computed together.
//!
//! **A shared network is published as one row an agent.** The agent's identity is a learned bias of the first
//! layer, which is what a one-hot input amounts to. So workers know one layout, and a reassembly takes rows of
//! any policy.

use tch::Tensor;

/// Actors that are computed together: every `step`-th from `first`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Actors {
    pub(crate) first: usize,
    pub(crate) step: usize,
    pub(crate) len: usize,
}

impl Actors {
    /// All there are.
    pub(crate) fn all(len: usize) -> Self {
        Self { first: 0, step: 1, len }
    }

    /// Their numbers.
    pub(crate) fn iter(&self) -> impl Iterator<Item = usize> + use<> {
        (self.first..).step_by(self.step).take(self.len)
    }

    /// Their rows of a tensor of all actors, in its memory.
    pub(crate) fn rows(&self, all: &Tensor) -> Tensor {
        let (first, step, len) = (self.first as i64, self.step as i64, self.len as i64);
        all.slice(0, first, first + step * (len - 1) + 1, step)
    }

    /// Whether no other actor's row lies between theirs.
    pub(crate) fn are_side_by_side(&self) -> bool {
        self.step == 1 || self.len == 1
    }
}
