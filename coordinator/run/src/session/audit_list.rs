//! What of other machines is being compared, and what came of it.

use std::collections::BTreeMap;

use proto::Digest;
use proto::message::{HostId, WorkerId, host_of};
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
}

/// Blocks of a host, and between which iterations they lie.
#[derive(Debug, Clone, Copy)]
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
    /// Blocks of a host that the learner has received since the last one that was the same.
    pub(super) since: BTreeMap<HostId, Span>,
    /// Names of hosts that are thrown out, and why.
    pub(super) refused: BTreeMap<String, String>,
}

impl Audits {
    /// The learner has received a block, and will train on it.
    pub(super) fn received(&mut self, worker: WorkerId, iteration: u64) {
        if let Some(host) = host_of(worker) {
            let none = Span { blocks: 0, first: iteration, last: iteration };
            let span = self.since.entry(host).or_insert(none);
            span.blocks += 1;
            span.first = span.first.min(iteration);
            span.last = span.last.max(iteration);
        }
    }

    /// A worker is no more: nothing will come of what it was to make. Whether anything of it was being compared.
    pub(super) fn forget_worker(&mut self, worker: WorkerId) -> bool {
        let before = self.open.len();
        self.open.retain(|(of, ..), _| *of != worker);
        self.open.len() < before
    }

    /// Another gateway gives the numbers of hosts to others.
    pub(super) fn forget_hosts(&mut self) {
        self.open.clear();
        self.same.clear();
        self.since.clear();
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
