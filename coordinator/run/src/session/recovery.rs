//! Who has died or fallen silent, and how the run goes on without what was lost.
//!
//! * A worker dies: its shards are open again, a successor starts after a back-off.
//! * The gateway dies: hosts lose it and join its successor; what they had to make is open again.
//! * A worker or the learner is silent for too long: it is killed, and so has died.
//! * The learner dies: everything since the last checkpoint is gone with it. All children are
//!   started anew from that checkpoint, the metrics are wound back, and every iteration that is
//!   trained on again must end with the digest that it had.
//! * The learner cannot start from a checkpoint, or finds another state there than the manifest says:
//!   the run goes on from the one before.
//! * A block cannot be made: see [`failures`](super::failures).
//!
//! **After the learner's death everything starts anew from the last checkpoint**, workers too. They hold orders
//! and policies of a future that is undone; a worker starts in 30 ms, and one way back is simpler to trust than
//! two. **Death by a signal from outside is no evidence** against the block at hand; a crash, an exit code or a
//! hang is. So many kills are survived, fifty in a row without a block or a newer iteration in between, and a block
//! that kills its worker by itself is found at the third time.

use std::time::Duration;

use proto::{ExitCode, ExitError};
use service::history::What;
use store::checkpoint::Checkpoint;

use super::Session;
use crate::deadlines::{START_DEADLINE, learner_start_deadline};
use crate::report::Reporter;
use crate::resume_point;
use crate::supervisor::{Cause, Death, Supervisor, log_tail};

impl Session<'_> {
    /// Reaps the dead, opens their shards again and starts successors.
    pub(super) fn replace_the_dead(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let deaths = supervisor.reap();
        if !deaths.is_empty() {
            self.headroom.release();
            // Once for all of them: it waits where one has died in the middle of something.
            self.channels.clean_up_after_the_dead();
            // Successors inherit what is open, and would keep the memory of the dead: it is closed when this
            // process hears that they are gone.
            self.hear_workers(supervisor, reporter)?;
        }
        for death in deaths {
            match death {
                Death::Learner(cause) => {
                    // Its last words may still be on the way.
                    self.hear_learner(supervisor, reporter)?;
                    return self.recover(cause, supervisor, reporter);
                }
                Death::Gateway(cause) => self.gateway_died(cause, supervisor, reporter)?,
                Death::Left(worker) => {
                    self.heard.remove(&worker);
                    self.early.retain(|(early, _)| *early != worker);
                    self.spec.live.tell(What::Left { worker: Some(worker) });
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.worker_gone(worker);
                    }
                    reporter.note(&format!("worker {worker} has left"));
                }
                Death::Worker(worker, cause) => {
                    self.heard.remove(&worker);
                    let died = What::Died { worker: Some(worker), cause: cause.to_string() };
                    self.spec.live.tell(died);
                    self.early.retain(|(early, _)| *early != worker);
                    let unfinished = self
                        .scheduler
                        .as_mut()
                        .map(|scheduler| scheduler.worker_gone(worker))
                        .unwrap_or_default();
                    // The worker was busy with the oldest; the others it had not begun.
                    if let Some((iteration, _)) = unfinished.undelivered.first() {
                        self.books.lost(*iteration, self.steps_per_block);
                    }
                    reporter.note(&format!(
                        "worker {worker} died ({cause}); {} open shards are ordered again",
                        unfinished.undelivered.len()
                    ));
                    if let Some(address) = unfinished.at_hand
                        && cause.blames_its_work()
                    {
                        let message = format!("its worker died ({cause})");
                        self.failures.failed(address, &message, None)?;
                    }
                    supervisor.check_deaths(worker, cause)?;
                }
            }
        }
        for worker in supervisor.start_due()? {
            reporter.note(&format!("worker {worker} has been replaced"));
        }
        Ok(())
    }

    /// Goes on from the last checkpoint after the learner's death.
    fn recover(
        &mut self,
        cause: Cause,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        if self.stopped_by.is_some() {
            return Err(self.died_while_stopping(cause));
        }
        let log = self.spec.run_dir.logs().join("learner.log");
        let is_up = self.scheduler.is_some();
        // With this code, and before it is ready, it says that the training state is none for it.
        if let Some((dir, _)) = &self.base
            && !is_up
            && matches!(cause, Cause::Crash(_))
            && cause.exit_code() == ExitCode::RunDirectory
        {
            let reason = format!("the learner refuses it: {}", log_tail(&log, 1));
            self.refused.insert(dir.clone(), reason);
            return self.leave_resume_point(supervisor, reporter);
        }
        self.learner_deaths.count(cause);
        // One that cannot even come up will not come up the next time.
        let is_hopeless = !is_up && matches!(cause, Cause::Crash(_) | Cause::SharedMemoryFull);
        if is_hopeless || self.learner_deaths.are_too_many() {
            // What has never come up does not do so for being asked again.
            let cure = if !is_hopeless && self.find_base().is_ok_and(|(base, _)| base.is_some()) {
                let run_dir = output::quoted(self.spec.run_dir.path());
                format!("\n`octopus resume {run_dir}` goes on from the last checkpoint")
            } else {
                String::new()
            };
            let message = format!(
                "the learner died ({cause}); the end of {}:\n{}{cure}",
                log.display(),
                log_tail(&log, 5)
            );
            return Err(ExitError::new(cause.exit_code(), message));
        }
        self.learner_restarts += 1;
        self.spec.live.tell(What::Died { worker: None, cause: cause.to_string() });
        self.go_back(&format!("the learner died ({cause})"), supervisor, reporter)
    }

    /// Leaves the checkpoint that the learner was started from for the one before, if it is none to
    /// start from.
    pub(super) fn leave_resume_point(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let refused = self.base.as_ref().and_then(|(dir, _)| self.refused.get(dir));
        if refused.is_none() {
            return Ok(());
        }
        self.go_back("the learner cannot start from that checkpoint", supervisor, reporter)
    }

    /// The checkpoint to go on from, and what is to be said about those that are none.
    fn find_base(&self) -> Result<(Option<Checkpoint>, Vec<String>), ExitError> {
        let run_dir = &self.spec.run_dir;
        resume_point::find(&self.store, run_dir, &self.refused)?.settle(run_dir)
    }

    /// Where a repetition of some iterations began: its checkpoint lies in the directory of another run, and it
    /// has none of its own.
    fn base_from_elsewhere(&self) -> Option<Checkpoint> {
        let begun = self.spec.resume.as_ref()?;
        let is_own = begun.dir.starts_with(self.store.root());
        (!is_own && !self.refused.contains_key(&begun.dir)).then(|| begun.clone())
    }

    /// Starts everything anew from the last checkpoint. `why` is told to the owner.
    fn go_back(
        &mut self,
        why: &str,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        // Workers hold orders and policies of the future that is now undone.
        supervisor.kill_all();
        self.snapshots.learner_gone();
        self.hear_committer(reporter)?;
        self.forget_what_was_said()?;
        self.channels.clean_up_after_the_dead();
        // Once more: only now it is closed, before successors inherit it, what the dead had sent.
        self.forget_what_was_said()?;
        let received = self.scheduler.take().map_or(0, |scheduler| scheduler.received());
        self.books.all_lost(received as u64 * self.steps_per_block);
        self.early.clear();
        for (worker, _) in std::mem::take(&mut self.heard) {
            self.spec.live.tell(What::Left { worker: Some(worker) });
        }
        self.forget_hosts();
        self.orders.forget_all();
        self.finishing = None;

        let (from, said) = self.find_base()?;
        let from = from.or_else(|| self.base_from_elsewhere());
        for sentence in said {
            reporter.note(&format!("warning: {sentence}"));
        }
        let iteration = from.as_ref().map_or(0, |checkpoint| checkpoint.manifest.iteration);
        self.audits.go_back(iteration);
        reporter.note(&format!("{why}; going on from iteration {iteration} of {}", self.reported));
        reporter.rewind(iteration).map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be rewound: {error:#}"))
        })?;
        self.snapshots.go_on_from(iteration);
        self.start_children(from.as_ref(), supervisor)
    }

    /// Takes what is still on its way from processes that are no more, and drops it.
    fn forget_what_was_said(&mut self) -> Result<(), ExitError> {
        while self.status.try_receive()?.is_some() {}
        while self.progress.try_receive()?.is_some() {}
        while self.pieces.try_receive()?.is_some() {}
        self.failures.take_policies()?;
        self.failures.forget_policies();
        Ok(())
    }

    /// The end of a run that somebody or its time limit has stopped: there is no time to train again
    /// what the learner has taken with it, and that must not look like a stop in order.
    fn died_while_stopping(&mut self, cause: Cause) -> ExitError {
        self.snapshots.learner_gone();
        let base = self.find_base().ok().and_then(|(base, _)| base);
        let kept = match base {
            Some(base) => {
                format!("the last checkpoint is of iteration {}", base.manifest.iteration)
            }
            None => "there is no checkpoint to go on from".to_owned(),
        };
        let message = format!(
            "the learner died ({cause}) while the run was stopping; {} done, and {kept}; `octopus resume \
             {}` trains what is missing again",
            output::counted(self.reported, "iteration"),
            output::quoted(self.spec.run_dir.path())
        );
        ExitError::new(cause.exit_code(), message)
    }

    /// Kills who has not been heard for too long.
    pub(super) fn check_deadlines(&mut self, supervisor: &mut Supervisor, reporter: &mut Reporter) {
        let now = self.attention.now();
        let deadline = Duration::from_secs_f64(self.spec.config.run.order_deadline_s);
        let start_deadline = deadline.max(START_DEADLINE);
        // When it was heard last, or started, and how long it may be silent.
        let silent: Vec<_> = supervisor
            .running_since()
            .filter_map(|(worker, started)| {
                let (since, deadline) = match self.heard.get(&worker) {
                    Some(&heard) => (heard, deadline),
                    None => (started, start_deadline),
                };
                (now.saturating_duration_since(since) > deadline)
                    .then_some((worker, deadline.as_secs_f64()))
            })
            .collect();
        for (worker, seconds) in silent {
            if supervisor.kill_worker(worker) {
                reporter.note(&format!(
                    "worker {worker} has been silent for {seconds} s and is replaced"
                ));
            }
        }
        self.check_gateway(deadline, start_deadline, supervisor, reporter);
        let deadline = match self.scheduler {
            Some(_) => deadline,
            None => learner_start_deadline(deadline, self.state_size),
        };
        if now.saturating_duration_since(self.learner_heard) > deadline {
            let seconds = deadline.as_secs_f64();
            reporter.note(&format!(
                "the learner has been silent for {seconds} s and is replaced; where it only needs \
                 longer, a larger run.order_deadline_s lets it"
            ));
            self.learner_heard = now;
            supervisor.kill_learner();
        }
    }
}
