//! Which hosts are trusted, and which of their blocks are for comparison: no process, clock or channel of its own.
//!
//! A host makes one block for comparison before anything else. Only when that is the same as this machine's own is it
//! given work whose results count. Of its later work a share is for comparison, too. Which that is depends on the
//! block's address alone, so that neither a clock nor who happens to be quick has a say.
//!
//! What a host makes for comparison is never trained on: the same block stays open for everybody. So nothing waits for
//! an answer, and one that is wrong is found without having done harm.

use std::collections::{BTreeMap, BTreeSet};

use proto::message::{HostId, WorkerId, host_of};
use proto::rng::{Address, Purpose};

use crate::task::ShardAddress;

/// How far a host is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Standing {
    /// It has made nothing yet.
    Unknown,
    /// Its first block is being made, or compared.
    OnTrial,
    /// Its work counts.
    Trusted,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Trials {
    seed: u64,
    share: f64,
    hosts: BTreeMap<HostId, Standing>,
    /// Blocks that have been given out for comparison; of iterations that are not over.
    chosen: BTreeSet<ShardAddress>,
}

impl Trials {
    /// For a run of this seed that compares this share of the blocks.
    pub(crate) fn new(seed: u64, share: f64) -> Self {
        Self { seed, share, hosts: BTreeMap::new(), chosen: BTreeSet::new() }
    }

    /// How far the host of a worker is; this machine is trusted.
    pub(crate) fn standing(&self, worker: WorkerId) -> Standing {
        host_of(worker).map_or(Standing::Trusted, |host| {
            self.hosts.get(&host).copied().unwrap_or(Standing::Unknown)
        })
    }

    /// The first block of a host is being made.
    pub(crate) fn begin(&mut self, host: HostId) {
        self.hosts.insert(host, Standing::OnTrial);
    }

    /// Nothing has come of the first block of a host: it has another one.
    pub(crate) fn begin_again(&mut self, host: HostId) {
        if self.hosts.get(&host) == Some(&Standing::OnTrial) {
            self.hosts.remove(&host);
        }
    }

    /// A block of a host was the same as this machine's. Whether it was its first.
    pub(crate) fn trust(&mut self, host: HostId) -> bool {
        self.hosts.insert(host, Standing::Trusted) != Some(Standing::Trusted)
    }

    /// Nothing is known of any host.
    pub(crate) fn forget_hosts(&mut self) {
        self.hosts.clear();
    }

    /// Whether a block that a worker of a trusted host is about to make is for comparison; once at most.
    pub(crate) fn takes(&mut self, worker: WorkerId, address: ShardAddress) -> bool {
        host_of(worker).is_some() && self.chooses(address) && self.chosen.insert(address)
    }

    fn chooses(&self, (iteration, shard): ShardAddress) -> bool {
        let address = Address {
            seed: self.seed,
            purpose: Purpose::Audit,
            iteration: iteration as u32,
            env: shard,
            step: 0,
            index: 0,
        };
        f64::from(address.uniforms()[0]) < self.share
    }

    /// All iterations before `trained` are over.
    pub(crate) fn iterations_done(&mut self, trained: u64) {
        self.chosen = self.chosen.split_off(&(trained, 0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_compared_blocks_is_the_one_asked_for_and_depends_on_the_address_alone() {
        let count = |seed, share| {
            let mut trials = Trials::new(seed, share);
            let taken = (0..10_000).filter(|&i| trials.takes(1000, (i / 8, (i % 8) as u32)));
            taken.collect::<Vec<_>>()
        };
        let some = count(1, 0.05);
        // 500 ± 5 standard deviations of 21.8.
        assert!((391..=609).contains(&some.len()), "{}", some.len());
        assert_eq!(some, count(1, 0.05));
        assert_ne!(some, count(2, 0.05));
        assert_eq!((count(1, 0.0).len(), count(1, 1.0).len()), (0, 10_000));
    }

    #[test]
    fn a_host_is_trusted_from_its_first_block_on_and_one_block_is_compared_once() {
        let mut trials = Trials::new(1, 1.0);
        assert_eq!(trials.standing(999), Standing::Trusted, "of this machine");
        assert_eq!(trials.standing(2001), Standing::Unknown);
        trials.begin(2);
        assert_eq!(trials.standing(2000), Standing::OnTrial);
        trials.begin_again(2);
        assert_eq!(trials.standing(2000), Standing::Unknown);
        trials.begin(2);
        assert!(trials.trust(2) && !trials.trust(2));
        trials.begin_again(2);
        assert_eq!(trials.standing(2001), Standing::Trusted);
        assert!(trials.takes(2001, (4, 0)) && !trials.takes(2000, (4, 0)));
        assert!(!trials.takes(3, (4, 1)), "of this machine");
        trials.iterations_done(5);
        assert!(trials.chosen.is_empty());
    }
}
