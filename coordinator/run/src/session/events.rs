//! What the processes of a run and its committer say, and what follows from it.

use std::time::{Duration, Instant};

use proto::message::{
    IterationReport, Order, PortId, Progress, Status, Timing, WorkerId, host_of, membership_of,
};
use proto::{ExitCode, ExitError};
use service::history::What;
use store::checkpoint::Name;

use super::order_queue::Addressee;
use super::snapshots::{Evaluation, Phase};
use super::{Session, StoppedBy};
use crate::committer::Committed;
use crate::deadlines::finish_deadline;
use crate::report::{Live, Reporter};
use crate::scheduler::Scheduler;
use crate::supervisor::Supervisor;

/// What metrics say of a run cannot be kept.
fn unwritten(error: &anyhow::Error) -> ExitError {
    ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be written: {error:#}"))
}

/// How long a learner that has said why it fails may take to end.
const LAST_WORD: Duration = Duration::from_secs(2);

/// Has a living worker get orders, now or as soon as the learner is ready, unless it does already.
pub(super) fn employ(
    scheduler: Option<&mut Scheduler>,
    early: &mut Vec<(WorkerId, u32)>,
    worker: WorkerId,
    incarnation: u32,
    now: Instant,
) {
    match scheduler {
        Some(scheduler) if !scheduler.knows(worker, incarnation) => {
            scheduler.worker_ready(worker, incarnation, now);
        }
        None if !early.contains(&(worker, incarnation)) => early.push((worker, incarnation)),
        _ => {}
    }
}

impl Session<'_> {
    pub(super) fn hear_workers(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let now = self.attention.now();
        while let Some(status) = self.status.try_receive()? {
            match status {
                Status::Ready { worker, incarnation, orders }
                | Status::Heartbeat { worker, incarnation, orders } => {
                    self.worker_lives(worker, incarnation, orders, supervisor)?;
                }
                Status::BlockDone {
                    worker,
                    incarnation,
                    iteration,
                    shard,
                    env_steps,
                    rollout_ns,
                } => {
                    let seconds = Duration::from_nanos(rollout_ns).as_secs_f64();
                    self.spec.live.tell(What::Block { worker, iteration, shard, seconds });
                    self.books.produced(iteration, env_steps);
                    self.monitor.block(worker, env_steps, rollout_ns);
                    if supervisor.is_current(worker, incarnation) {
                        self.heard.insert(worker, now);
                        supervisor.worker_delivered(worker);
                    }
                }
                Status::Audited { worker, incarnation, iteration, shard, digest } => {
                    self.audited(worker, incarnation, (iteration, shard), Ok(digest));
                }
                Status::EvaluationDone { chunk, errors, .. } => {
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.evaluation_done(chunk, now);
                    }
                    if let Some(deadline) = &mut self.finishing {
                        *deadline = now + finish_deadline(self.state_size);
                    }
                    if let Some(evaluated) = self.snapshots.played(chunk, errors) {
                        let wall_s = self.started.elapsed().as_secs_f64();
                        reporter
                            .evaluation(&evaluated, wall_s)
                            .map_err(|error| unwritten(&error))?;
                    }
                }
                Status::Failed { worker, incarnation, message, fault } => {
                    reporter.note(&format!("worker {worker}: {message}"));
                    let Some(fault) = fault else { continue };
                    let address = (fault.iteration, fault.shard);
                    if self.audits.is_doubted(&(worker, incarnation, address)) {
                        // It has been given the block again before this machine had made it.
                        if let Some(scheduler) = &mut self.scheduler {
                            scheduler.give_back(worker, address, now);
                        }
                        continue;
                    }
                    if self.audited(worker, incarnation, address, Err(message.clone())) {
                        continue;
                    }
                    let is_current = supervisor.is_current(worker, incarnation)
                        || self.hosts.has(worker, incarnation);
                    if is_current && let Some(scheduler) = &mut self.scheduler {
                        scheduler.give_back(worker, address, now);
                        if host_of(worker).is_some() {
                            self.doubt((worker, incarnation), address, message, fault)?;
                        } else {
                            self.failures.failed(address, &message, Some(&fault))?;
                        }
                    }
                }
                Status::Hosts { incarnation, orders, refused, hosts } => {
                    if (refused as usize) < self.audits.refused.len() {
                        self.refuse_hosts()?;
                    }
                    self.hear_hosts(incarnation, orders, hosts, supervisor, reporter);
                    self.scale_hosts(reporter)?;
                }
                other => tracing::warn!(?other, "status of an unknown kind"),
            }
        }
        Ok(())
    }

    /// A worker says that it is there and where it takes orders. It does so first when it is ready; where
    /// that word was pushed out of the queue, because this process stood still, its next one counts as much.
    fn worker_lives(
        &mut self,
        worker: WorkerId,
        incarnation: u32,
        orders: PortId,
        supervisor: &Supervisor,
    ) -> Result<(), ExitError> {
        let is_leaving = supervisor.is_leaving(worker, incarnation);
        let is_current = supervisor.is_current(worker, incarnation);
        if !is_leaving && !is_current {
            // A late word of the dead.
            return Ok(());
        }
        let is_new = self.orders.introduce(Addressee::Worker(worker), orders);
        if is_leaving {
            if is_new {
                self.orders.send(Order::Leave { worker, incarnation })?;
            }
            return Ok(());
        }
        let now = self.attention.now();
        if self.heard.insert(worker, now).is_none() {
            self.spec.live.tell(What::Ready { worker: Some(worker) });
        }
        employ(self.scheduler.as_mut(), &mut self.early, worker, incarnation, now);
        Ok(())
    }

    pub(super) fn hear_learner(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let now = self.attention.now();
        while let Some(progress) = self.progress.try_receive()? {
            self.learner_heard = now;
            match progress {
                Progress::Ready { iteration, digest, precision, orders, .. } => {
                    self.orders.introduce(Addressee::Learner, orders);
                    tracing::info!(iteration, %digest, precision, "learner is ready");
                    if let Some((dir, expected)) = &self.base
                        && *expected != digest
                    {
                        let reason = format!(
                            "the learner found digest {digest} in its training state, not that of \
                             its manifest, {expected}: one of the two was changed, or run.precision"
                        );
                        self.refused.insert(dir.clone(), reason);
                        continue;
                    }
                    self.learner_ready(iteration, now, reporter)?;
                }
                Progress::Heartbeat => {}
                Progress::BlockReceived {
                    iteration,
                    shard,
                    worker,
                    incarnation,
                    duplicate,
                    digest,
                } => {
                    if !duplicate {
                        let host = membership_of(worker, incarnation);
                        if let Some(host) = host {
                            self.audits.received(host, iteration);
                        }
                        let of_iteration = self.blocks.entry(iteration).or_default();
                        of_iteration.insert(shard, (digest, host));
                    }
                    self.failures.made((iteration, shard));
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.block_received((iteration, shard), now);
                    }
                }
                Progress::BlockDiscarded { iteration, shard } => {
                    if let Some(blocks) = self.blocks.get_mut(&iteration) {
                        blocks.remove(&shard);
                    }
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.block_discarded((iteration, shard));
                    }
                }
                Progress::IterationDone(report) => {
                    self.iteration_done(*report, supervisor, reporter)?;
                }
                Progress::Failed { message } => {
                    let code = supervisor.learner_exit_code(LAST_WORD);
                    return Err(ExitError::new(code, format!("learner: {message}")));
                }
                other => tracing::warn!(?other, "progress of an unknown kind"),
            }
        }
        Ok(())
    }

    fn learner_ready(
        &mut self,
        iteration: u64,
        now: Instant,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let expected = self.origin;
        if iteration != expected {
            return Err(ExitError::new(
                ExitCode::Child,
                format!("the learner starts at iteration {iteration} instead of {expected}"),
            ));
        }
        let config = &self.spec.config;
        let planned = config.planned_iterations();
        let end = self.spec.until.map_or(planned, |until| planned.min(until));
        let mut scheduler = Scheduler::new(
            config.env.n_shards as u32,
            config.run.overlap,
            iteration,
            end.max(iteration),
        )
        .with_audits(config.run.seed, config.run.audit);
        for (worker, incarnation) in self.early.drain(..) {
            scheduler.worker_ready(worker, incarnation, now);
        }
        if self.stopped_by.is_some() {
            scheduler.stop_after_current();
        }
        if self.learner_restarts > 0 {
            reporter.note(&format!("the learner has been replaced, at iteration {iteration}"));
        }
        self.spec.live.tell(What::Ready { worker: None });
        self.scheduler = Some(scheduler);
        self.last_report = now;
        Ok(())
    }

    fn iteration_done(
        &mut self,
        mut report: IterationReport,
        supervisor: &Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let iteration = report.iteration;
        self.books.close(&mut report, self.spec.config.steps_per_iteration())?;
        reporter.check_promised(iteration, report.digest)?;
        let elapsed = self.last_report.elapsed().as_secs_f64();
        self.last_report = Instant::now();
        let blocks = self.blocks.remove(&iteration).unwrap_or_default().into_values();
        let (blocks, makers): (Vec<_>, Vec<_>) = blocks.unzip();
        // Late duplicates of iterations that are over.
        self.blocks.retain(|other, _| *other > iteration);
        let live = Live {
            wall_s: self.started.elapsed().as_secs_f64(),
            env_steps_per_s: report.accounting.trained as f64 / elapsed,
            workers: self.workers,
            restarts: supervisor.restarts() + self.learner_restarts,
            blocks,
            hosts: self.hosts.shares(makers.into_iter().flatten()),
        };
        let line = reporter.iteration(&report, &live).map_err(|error| unwritten(&error))?;
        let Timing { update_s, publish_s, digest_s, copy_s, .. } = report.timing;
        let seconds = update_s + publish_s + digest_s + copy_s;
        self.spec.live.tell(What::Update { iteration, seconds });
        self.monitor.iteration(&report);
        self.monitor.env_steps_per_s = live.env_steps_per_s;
        self.monitor.eta.iteration(report.accounting.trained, live.env_steps_per_s);
        self.monitor.divergence = reporter.diverged().cloned();
        self.monitor.last = line;
        self.reported = iteration + 1;
        self.learner_deaths.trained(self.reported);
        if let Some(scheduler) = &mut self.scheduler {
            scheduler.iteration_done(iteration);
        }
        self.snapshots.iteration_done(self.reported);
        Ok(())
    }

    pub(super) fn collect_pieces(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        while let Some(piece) = self.pieces.try_receive()? {
            let Some(snapshot) = self.snapshots.add(piece.header(), piece.payload()) else {
                continue;
            };
            // No checkpoint without the lines of its iterations: the learner reported them before
            // it sent the snapshot, and the committer waits until they are durable.
            self.hear_learner(supervisor, reporter)?;
            let phase = match self.finishing {
                None => Phase::Training,
                Some(_) => {
                    Phase::Finishing { evaluate: self.stopped_by != Some(StoppedBy::Signal) }
                }
            };
            let Evaluation { play, drop } = self.snapshots.arrived(snapshot, phase);
            if let Some(scheduler) = &mut self.scheduler {
                for chunk in drop {
                    scheduler.evaluation_done(chunk, self.attention.now());
                }
                scheduler.evaluate(play);
            }
        }
        Ok(())
    }

    pub(super) fn hear_committer(&mut self, reporter: &mut Reporter) -> Result<(), ExitError> {
        for result in self.snapshots.results() {
            match result {
                Committed::Checkpoint { iteration, dir, elapsed } => {
                    // What stands there now is what the run has trained again.
                    self.refused.remove(&dir);
                    self.monitor.commits += 1;
                    self.monitor.stages.commit_s += elapsed.as_secs_f64();
                    let name = Name::of_iteration(iteration).to_string();
                    tracing::info!(name, seconds = elapsed.as_secs_f64(), "checkpoint committed");
                    self.monitor.checkpoint = Some(name);
                }
                Committed::Score { iteration, value, best } => {
                    tracing::info!(iteration, value, best, "checkpoint scored");
                    if best {
                        let name = Name::of_iteration(iteration).to_string();
                        self.monitor.best = Some((name, value));
                    }
                }
                Committed::Failed { iteration, error } => {
                    let message = format!("checkpoint {iteration} not committed: {error}");
                    if self.finishing.is_some() && iteration == self.reported {
                        return Err(ExitError::new(ExitCode::RunDirectory, message));
                    }
                    // What was committed before is whole, and there may be room again next time.
                    reporter.note(&format!("warning: {message}; the training goes on without it"));
                }
                Committed::Unrecorded { error, .. } => return Err(unwritten(&error)),
                Committed::ScoreFailed { iteration, error } => reporter.note(&format!(
                    "warning: the score of checkpoint {iteration} was not written: {error}"
                )),
                Committed::GivenUp { iteration } => reporter.note(&format!(
                    "warning: checkpoint {iteration} not committed: the one before was still on its \
                     way to the disk when the next one came"
                )),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first word of a worker was the only one that got it orders, and a coordinator that stood still
    /// for half a minute never heard it.
    #[test]
    fn a_worker_whose_first_word_was_lost_gets_orders_after_the_next_and_once() {
        let now = Instant::now();
        let mut early = Vec::new();
        // Before the learner is ready.
        for _ in 0..3 {
            employ(None, &mut early, 4, 0, now);
        }
        employ(None, &mut early, 5, 0, now);
        assert_eq!(early, [(4, 0), (5, 0)]);
        // And after.
        let mut scheduler = Scheduler::new(3, 0, 0, 1);
        employ(Some(&mut scheduler), &mut early, 4, 0, now);
        let orders = scheduler.assign(now);
        assert_eq!(orders.len(), 2);
        employ(Some(&mut scheduler), &mut early, 4, 0, now);
        assert!(orders.iter().all(|order| scheduler.awaits(order)), "it keeps what it has");
        // A successor has nothing of that.
        employ(Some(&mut scheduler), &mut early, 4, 1, now);
        assert!(!orders.iter().any(|order| scheduler.awaits(order)));
        assert_eq!(scheduler.assign(now).len(), 2);
        assert_eq!(early.len(), 2);
    }
}
