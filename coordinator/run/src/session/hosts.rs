//! Other machines: which of their workers take orders, by what the gateway says.
//!
//! A worker of a host is one like any other, but that nobody here starts, kills or replaces it: it is there as long as
//! the gateway says so. The gateway always says the whole list, so that a word that is lost takes nothing with it.

use std::collections::BTreeMap;
use std::time::Duration;

use proto::ExitError;
use proto::message::{HostReport, Order, PortId, WorkerId, host_of};
use service::history::What;

use super::Session;
use super::events::employ;
use super::order_queue::Addressee;
use crate::report::Reporter;
use crate::supervisor::{Cause, Supervisor};

impl Session<'_> {
    /// The gateway says which hosts there are, and where their workers take orders.
    pub(super) fn hear_hosts(
        &mut self,
        incarnation: u32,
        orders: PortId,
        mut hosts: Vec<HostReport>,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) {
        if !supervisor.is_gateway(incarnation) {
            // A late word of the dead.
            return;
        }
        supervisor.gateway_lives();
        let now = self.attention.now();
        self.hosts.heard = Some(now);
        self.hosts.gateway = Some(incarnation);
        // The gateway may not have heard yet whom it is to refuse.
        hosts.retain(|host| !self.audits.refused.contains_key(&host.name));
        self.hosts
            .names
            .extend(hosts.iter().map(|host| ((incarnation, host.host), host.name.clone())));
        let there: BTreeMap<_, _> = hosts.iter().flat_map(|host| host.workers.clone()).collect();
        let reports = std::mem::replace(&mut self.hosts.reports, hosts);
        let is_gone =
            |(worker, incarnation): &(&WorkerId, &u32)| there.get(worker) != Some(incarnation);
        let gone = self.hosts.workers.iter().filter(is_gone);
        let gone: Vec<_> = gone.map(|(&worker, _)| worker).collect();
        let open = self.let_go(&gone);
        for (&worker, &incarnation) in &there {
            self.orders.introduce(Addressee::Worker(worker), orders);
            employ(self.scheduler.as_mut(), &mut self.early, worker, incarnation, now);
            if self.hosts.workers.insert(worker, incarnation).is_none() {
                self.spec.live.tell(What::Ready { worker: Some(worker) });
            }
        }
        self.note_changes(&reports, open, reporter);
    }

    /// Tells the gateway which hosts are to have other numbers of workers, as long as it says otherwise and they can.
    pub(super) fn scale_hosts(&mut self, reporter: &mut Reporter) -> Result<(), ExitError> {
        for HostReport { host, name, wanted, most, .. } in &self.hosts.reports {
            let Some(&workers) = self.hosts.wanted.get(host).filter(|other| *other != wanted)
            else {
                continue;
            };
            if workers > *most {
                // Others have taken the room since it was asked for.
                self.hosts.wanted.remove(host);
                reporter.note(&format!(
                    "host {host} ({name}) stays at {}: it can have {most} at most now",
                    output::counted(u64::from(*wanted), "worker")
                ));
                continue;
            }
            self.orders.send(Order::ScaleHost { host: *host, workers })?;
        }
        Ok(())
    }

    /// Workers of hosts are no more; returns how many shards are open again.
    pub(super) fn let_go(&mut self, workers: &[WorkerId]) -> usize {
        let mut open = 0;
        for &worker in workers {
            self.hosts.workers.remove(&worker);
            if let (true, Some(scheduler), Some(host)) =
                (self.audits.forget_worker(worker), &mut self.scheduler, host_of(worker))
            {
                scheduler.try_again(host);
            }
            self.early.retain(|(early, _)| *early != worker);
            let unfinished = self.scheduler.as_mut().map(|scheduler| scheduler.worker_gone(worker));
            let undelivered = unfinished.unwrap_or_default().undelivered;
            // What its host has begun is dropped by the gateway, should it come all the same.
            if let Some((iteration, _)) = undelivered.first() {
                self.books.lost(*iteration, self.steps_per_block);
            }
            open += undelivered.len();
            self.spec.live.tell(What::Left { worker: Some(worker) });
        }
        open
    }

    /// Tells the owner which hosts have come and gone, compared with `before`.
    fn note_changes(&self, before: &[HostReport], open: usize, reporter: &mut Reporter) {
        let count = |reports: &[HostReport], host| {
            let report = reports.iter().find(|report| report.host == host);
            report.map_or(0, |report| report.workers.len())
        };
        let now = &self.hosts.reports;
        let named: BTreeMap<_, _> =
            before.iter().chain(now).map(|report| (report.host, &report.name)).collect();
        for (host, name) in named {
            let (had, has) = (count(before, host), count(now, host));
            let workers = output::counted(has as u64, "worker");
            if has > had {
                reporter.note(&format!("host {host} ({name}) helps with {workers}"));
                if had == 0 && now.iter().any(|it| it.host == host && it.is_other_processor) {
                    reporter.note(&format!(
                        "host {host} ({name}) has another type of processor, which logs/gateway.log names; it must make \
                         the same bits all the same, and its first block is compared"
                    ));
                }
            } else if has < had {
                reporter.note(&format!(
                    "host {host} ({name}) helps with {workers}, before {had}; {} ordered again",
                    output::counted(open as u64, "open shard")
                ));
            }
        }
    }

    /// The gateway has died, and nobody reaches its hosts any more until they have joined its successor.
    pub(super) fn gateway_died(
        &mut self,
        cause: Cause,
        supervisor: &Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let workers: Vec<_> = self.hosts.workers.keys().copied().collect();
        let open = self.let_go(&workers);
        self.hosts.forget();
        self.audits.forget_hosts();
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.forget_hosts();
        }
        reporter.note(&format!(
            "the gateway died ({cause}) and is replaced; {} of hosts ordered again",
            output::counted(open as u64, "open shard")
        ));
        supervisor.check_gateway_deaths(cause)
    }

    /// Everything starts anew, and hosts join again.
    pub(super) fn forget_hosts(&mut self) {
        self.audits.forget_hosts();
        for worker in self.hosts.forget().into_keys() {
            self.spec.live.tell(What::Left { worker: Some(worker) });
        }
    }

    /// Kills a gateway that has been silent for longer than `deadline`, or than `start_deadline` since its start.
    pub(super) fn check_gateway(
        &self,
        deadline: Duration,
        start_deadline: Duration,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) {
        let Some(started) = supervisor.gateway_since() else { return };
        let (since, deadline) = match self.hosts.heard {
            Some(heard) => (heard, deadline),
            None => (started, start_deadline),
        };
        let silent = self.attention.now().saturating_duration_since(since) > deadline;
        if silent && supervisor.kill_gateway() {
            let seconds = deadline.as_secs_f64();
            reporter.note(&format!("the gateway has been silent for {seconds} s and is replaced"));
        }
    }
}
