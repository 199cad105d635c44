//! Blocks of other machines that are made a second time here, and compared.
//!
//! The processor of another machine may compute otherwise than its type promises, or be broken. What its workers make
//! for comparison (see [`trials`](crate::trials)) is made here as well, by the [auditor](crate::auditor), and both
//! digests must be equal. A host whose block differs is thrown out, and so is one that cannot make a
//! block that can be made here: its name is refused, its workers are let go, and the
//! learner drops what it has of it and has not begun to train on. What the learner has trained on since the last
//! comparison that was good cannot be taken back; it is said.

use proto::message::{
    Fault, Membership, Order, WorkerId, host_of, membership_of, policy_version_for,
};
use proto::{Digest, ExitError};

use super::Session;
use super::audit_list::{BlockId, Pair, Span};
use crate::auditor::Auditor;
use crate::report::Reporter;
use crate::scheduler::ShardAddress;

impl Session<'_> {
    /// A host has been ordered a block for comparison: it is made here, too.
    pub(super) fn audit(
        &mut self,
        worker: WorkerId,
        incarnation: u32,
        address: ShardAddress,
    ) -> Result<(), ExitError> {
        let version = policy_version_for(address.0, self.spec.config.run.overlap);
        // It may have come since the last look.
        self.failures.take_policies()?;
        let Some(policy) = self.failures.policy(version) else {
            tracing::warn!(version, "the policy of a block that is to be compared is not here");
            return Ok(());
        };
        let wanted =
            self.audits.auditor.as_ref().is_some_and(|one| one.want(address, policy.clone()));
        if !wanted {
            let failed = |error| {
                let message = format!("cannot start a thread: {error}");
                ExitError::new(proto::ExitCode::Environment, message)
            };
            let auditor = Auditor::start(&self.spec.config, &self.spec.robot).map_err(failed)?;
            auditor.want(address, policy);
            self.audits.auditor = Some(auditor);
        }
        // One that is ordered again is the same.
        self.audits.open.entry((worker, incarnation, address)).or_default();
        Ok(())
    }

    /// A worker of a host cannot make a block that it was ordered. A machine that is broken is no reason to end the run: it is made
    /// here, too, and counts as failed if that cannot be done either.
    pub(super) fn doubt(
        &mut self,
        (worker, incarnation): (WorkerId, u32),
        address: ShardAddress,
        message: String,
        fault: Box<Fault>,
    ) -> Result<(), ExitError> {
        self.audit(worker, incarnation, address)?;
        match self.audits.open.get_mut(&(worker, incarnation, address)) {
            Some(pair) => {
                pair.there = Some(Err(message));
                pair.fault = Some(fault);
                Ok(())
            }
            None => self.failures.failed(address, &message, Some(&fault)),
        }
    }

    /// A host has made a block for comparison, or says why it cannot. Whether it was to.
    pub(super) fn audited(
        &mut self,
        worker: WorkerId,
        incarnation: u32,
        address: ShardAddress,
        made: Result<Digest, String>,
    ) -> bool {
        let now = self.attention.now();
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.audit_made(worker, address, now);
        }
        let open = self.audits.open.get_mut(&(worker, incarnation, address));
        let is_open = open.map(|pair| pair.there = Some(made)).is_some();
        if let (false, Some(scheduler), Some(host)) =
            (is_open, &mut self.scheduler, host_of(worker))
        {
            scheduler.try_again(host);
        }
        is_open
    }

    /// Compares what has been made twice.
    pub(super) fn compare(&mut self, reporter: &mut Reporter) -> Result<(), ExitError> {
        let made = self.audits.auditor.as_ref().map(Auditor::made).unwrap_or_default();
        for (address, result) in made {
            let open = self.audits.open.iter_mut();
            for (_, pair) in open.filter(|((_, _, of), _)| *of == address) {
                pair.here = Some(result.clone());
            }
        }
        let whole = |_: &BlockId, pair: &mut Pair| pair.here.is_some() && pair.there.is_some();
        let whole: Vec<_> = self.audits.open.extract_if(.., whole).collect();
        for ((worker, incarnation, address), pair) in whole {
            let membership = membership_of(worker, incarnation);
            let (Some(membership), Some(here), Some(there)) = (membership, pair.here, pair.there)
            else {
                continue;
            };
            let (_, host) = membership;
            let steps = self.steps_per_block;
            let iteration = address.0.max(self.reported);
            match (here, there) {
                (Ok(here), Ok(there)) if here == there => {
                    self.books.compared(iteration, steps);
                    *self.audits.same.entry(host).or_default() += 1;
                    let name = self.hosts.name(membership);
                    // Another machine of that name that is there now answers for itself.
                    let mut its = self.hosts.memberships(name);
                    its.retain(|of| *of == membership || !self.hosts.is_there(*of));
                    self.audits.take_since(&its);
                    if let Some(scheduler) = &mut self.scheduler
                        && scheduler.trust(host)
                    {
                        reporter.note(&format!(
                            "host {host} ({name}) has made its first block, {}/{}, with the same bits as this machine",
                            address.0, address.1
                        ));
                    }
                }
                // What cannot be made here cannot be made there: the failures of the run say more.
                (Err(_), Err(message)) => {
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.try_again(host);
                    }
                    if let Some(fault) = pair.fault {
                        self.failures.failed(address, &message, Some(&fault))?;
                    }
                }
                (here, there) => {
                    if there.is_ok() {
                        self.books.differs(iteration, steps);
                    }
                    let shown = |made: Result<Digest, String>| match made {
                        Ok(digest) => digest.to_string(),
                        Err(why) => format!("none ({why})"),
                    };
                    let what = format!(
                        "made block {}/{} with digest {}; this machine makes it with {}",
                        address.0,
                        address.1,
                        shown(there),
                        shown(here)
                    );
                    self.throw_out(membership, &what, reporter)?;
                }
            }
        }
        Ok(())
    }

    /// Has nothing to do any more with a host that makes other bits, or none where this machine makes some.
    fn throw_out(
        &mut self,
        membership: Membership,
        what: &str,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let (_, host) = membership;
        let name = self.hosts.name(membership).to_owned();
        if self.audits.refused.contains_key(&name) {
            return Ok(());
        }
        // It may have come back under another number, and its blocks of before are no better.
        let memberships = self.hosts.memberships(&name);
        let since = self.audits.take_since(&memberships);
        // Those of an iteration that is being trained on count as trained on.
        let harm = match since.filter(|since| since.first <= self.reported) {
            Some(Span { blocks, first, last }) => format!(
                "up to {} of it, of iterations {first} to {}, may have been trained on since its last block that was the same",
                output::counted(blocks, "block"),
                last.min(self.reported)
            ),
            None => "nothing of it has been trained on".to_owned(),
        };
        reporter.note(&format!(
            "warning: host {host} ({name}) {what}. It is thrown out and not taken back; {harm}"
        ));
        self.hosts.reports.retain(|report| report.name != name);
        self.audits.refused.insert(name, format!("{what}; {harm}"));
        let is_its = |(worker, incarnation): &(&WorkerId, &u32)| {
            membership_of(**worker, **incarnation).is_some_and(|of| memberships.contains(&of))
        };
        let workers = self.hosts.workers.iter().filter(is_its).map(|(worker, _)| *worker);
        let workers: Vec<_> = workers.collect();
        self.let_go(&workers);
        for &(gateway, host) in &memberships {
            self.orders.send(Order::Discard { host, gateway })?;
        }
        self.refuse_hosts()
    }

    /// Tells the gateway whom it is to refuse.
    pub(super) fn refuse_hosts(&mut self) -> Result<(), ExitError> {
        for name in self.audits.refused.keys() {
            self.orders.send(Order::Refuse { name: name.clone() })?;
        }
        Ok(())
    }
}
