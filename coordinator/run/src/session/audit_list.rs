//! What of other machines is being compared, and what came of it.

use std::collections::BTreeMap;

use proto::Digest;
use proto::message::{Fault, HostId, Membership, WorkerId};
use service::live::RefusedHost;

use crate::auditor::Auditor;
use crate::scheduler::ShardAddress;

/// Who is to make which block: a worker and its incarnation.
pub(super) type BlockId = (WorkerId, u32, ShardAddress);

/// Both digests of a block, or why it could not be made.
#[derive(Debug, Default)]
pub(super) struct Pair {
    pub(super) here: Option<Result<Digest, String>>,
    pub(super) there: Option<Result<Digest, String>>,
    /// What went wrong there, if the block was not for comparison: it counts unless it can be made here.
    pub(super) fault: Option<Box<Fault>>,
}

/// Blocks of a host, and between which iterations they lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Span {
    pub(super) blocks: u64,
    pub(super) first: u64,
    pub(super) last: u64,
}

/// What is being compared, and what came of it.
#[derive(Debug, Default)]
pub(super) struct Audits {
    pub(super) auditor: Option<Auditor>,
    pub(super) open: BTreeMap<BlockId, Pair>,
    /// Blocks that were the same, by host.
    pub(super) same: BTreeMap<HostId, u64>,
    /// Blocks of a host that the learner has received since the last one of its machine that was the same.
    since: BTreeMap<Membership, Span>,
    /// Names of hosts that are thrown out, and why.
    pub(super) refused: BTreeMap<String, String>,
}

impl Span {
    fn and(self, other: Self) -> Self {
        Self {
            blocks: self.blocks + other.blocks,
            first: self.first.min(other.first),
            last: self.last.max(other.last),
        }
    }
}

impl Audits {
    /// The learner has received a block of a host, and will train on it.
    pub(super) fn received(&mut self, host: Membership, iteration: u64) {
        let one = Span { blocks: 1, first: iteration, last: iteration };
        self.since.entry(host).and_modify(|span| *span = span.and(one)).or_insert(one);
    }

    /// Takes what the learner has received of a machine since the last block that was the same, whichever of its memberships
    /// it came by.
    pub(super) fn take_since(&mut self, memberships: &[Membership]) -> Option<Span> {
        memberships.iter().filter_map(|host| self.since.remove(host)).reduce(Span::and)
    }

    /// A worker is no more: nothing will come of what it was to make. Whether anything of it was being compared.
    pub(super) fn forget_worker(&mut self, worker: WorkerId) -> bool {
        let before = self.open.len();
        self.open.retain(|(of, ..), _| *of != worker);
        self.open.len() < before
    }

    /// Whether a worker has said that it cannot make a block, which is being made here.
    pub(super) fn is_doubted(&self, block: &BlockId) -> bool {
        self.open.get(block).is_some_and(|pair| pair.fault.is_some())
    }

    /// The run goes back: nothing is trained on from this iteration on.
    pub(super) fn go_back(&mut self, iteration: u64) {
        self.since.retain(|_, span| span.first < iteration);
        for span in self.since.values_mut() {
            span.last = span.last.min(iteration.saturating_sub(1));
        }
    }

    /// Another gateway gives the numbers of hosts to others. What has been trained on stays so.
    pub(super) fn forget_hosts(&mut self) {
        self.open.clear();
        self.same.clear();
    }

    /// Those that are thrown out, for the run's status.
    pub(super) fn look(&self) -> Vec<RefusedHost> {
        let look = |(name, reason): (&String, &String)| RefusedHost {
            name: name.clone(),
            reason: reason.clone(),
        };
        self.refused.iter().map(look).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_answers_for_all_its_memberships() {
        let mut audits = Audits::default();
        for (host, iteration) in [((0, 1), 7), ((0, 1), 9), ((1, 1), 3), ((1, 2), 12)] {
            audits.received(host, iteration);
        }
        audits.forget_hosts();
        let span = |blocks, first, last| Some(Span { blocks, first, last });
        assert_eq!(audits.take_since(&[(0, 1), (1, 2), (5, 5)]), span(3, 7, 12));
        assert_eq!(audits.take_since(&[(0, 1), (1, 2)]), None);
        assert_eq!(audits.take_since(&[(1, 1)]), span(1, 3, 3), "another machine's");
        for iteration in [4, 6, 8] {
            audits.received((2, 1), iteration);
            audits.received((2, 2), iteration + 4);
        }
        audits.go_back(7);
        assert_eq!(audits.take_since(&[(2, 1)]), span(3, 4, 6), "at most so many");
        assert_eq!(audits.take_since(&[(2, 2)]), None);
    }
}
