//! What is known of other machines.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use proto::message::{HostId, HostReport, Membership, WorkerId};
use service::live::HostStatus;

use crate::scheduler::Scheduler;

/// The hosts of a session.
#[derive(Debug, Default)]
pub(super) struct Hosts {
    /// The gateway that was heard last.
    pub(super) gateway: Option<u32>,
    /// Incarnations of the workers that take orders.
    pub(super) workers: BTreeMap<WorkerId, u32>,
    /// What the gateway said last.
    pub(super) reports: Vec<HostReport>,
    /// What hosts call themselves, those that have gone included, also with a gateway of before.
    pub(super) names: BTreeMap<Membership, String>,
    /// How many workers a host is to have, where somebody has changed that.
    pub(super) wanted: BTreeMap<HostId, u32>,
    /// When the gateway was heard last; none if the one that runs now has not been.
    pub(super) heard: Option<Instant>,
}

impl Hosts {
    /// Nobody could be heard for so long.
    pub(super) fn postpone(&mut self, late: Duration) {
        if let Some(heard) = &mut self.heard {
            *heard += late;
        }
    }

    /// Whether the gateway has been heard.
    pub(super) fn is_ready(&self) -> bool {
        self.heard.is_some()
    }

    /// Whether this worker takes orders in this incarnation.
    pub(super) fn has(&self, worker: WorkerId, incarnation: u32) -> bool {
        self.workers.get(&worker) == Some(&incarnation)
    }

    /// What a host calls itself.
    pub(super) fn name(&self, host: Membership) -> &str {
        self.names.get(&host).map_or("unknown", String::as_str)
    }

    /// All memberships of machines that call themselves so.
    pub(super) fn memberships(&self, name: &str) -> Vec<Membership> {
        let of_name = self.names.iter().filter(|(_, other)| *other == name);
        of_name.map(|(membership, _)| *membership).collect()
    }

    /// Whether a host is there now.
    pub(super) fn is_there(&self, (gateway, host): Membership) -> bool {
        self.gateway == Some(gateway) && self.reports.iter().any(|report| report.host == host)
    }

    /// Nobody is there; names stay, for what they have made may have been trained on. The workers that were.
    pub(super) fn forget(&mut self) -> BTreeMap<WorkerId, u32> {
        let names = std::mem::take(&mut self.names);
        std::mem::replace(self, Self { names, ..Self::default() }).workers
    }

    /// How many of these blocks, none of which is of this machine, each host has made, by the hosts' names.
    pub(super) fn shares(&self, makers: impl Iterator<Item = Membership>) -> BTreeMap<String, u64> {
        let mut shares = BTreeMap::new();
        for host in makers {
            *shares.entry(self.name(host).to_owned()).or_default() += 1;
        }
        shares
    }

    /// The hosts for the status of the run; `same` says how many of their blocks were compared.
    pub(super) fn look(
        &self,
        scheduler: Option<&Scheduler>,
        same: &BTreeMap<HostId, u64>,
    ) -> Vec<HostStatus> {
        let look = |report: &HostReport| {
            let workers: Vec<_> = report.workers.iter().map(|(worker, _)| *worker).collect();
            let tasks = workers.iter().filter_map(|&worker| Some(scheduler?.tasks(worker)));
            HostStatus {
                host: report.host,
                name: report.name.clone(),
                shards: tasks.flatten().map(ToString::to_string).collect(),
                workers,
                wanted: report.wanted as usize,
                max_workers: report.most as usize,
                compared: same.get(&report.host).copied().unwrap_or(0),
                blocks: report.blocks,
                bytes: report.bytes,
                missing: report.missing,
            }
        };
        self.reports.iter().map(look).collect()
    }
}
