//! Who has died or fallen silent, and how the run goes on without what was lost.
//!
//! * A worker dies: its shards are open again, a successor starts after a back-off.
//! * A worker or the learner is silent for too long: it is killed, and so has died.
//! * The learner dies: everything since the last checkpoint is gone with it. All children are
//!   started anew from that checkpoint, the metrics are wound back, and every iteration that is
//!   trained on again must end with the digest that it had.
//! * A block cannot be made: see [`failures`](super::failures).
//!
//! **After the learner's death everything starts anew from the last checkpoint**, workers too. They hold orders
//! and policies of a future that is undone; a worker starts in 30 ms, and one way back is simpler to trust than
//! two. **Death by a signal from outside is no evidence** against the block at hand; a crash, an exit code or a
//! hang is. So any number of kills is survived, and a block that kills its worker by itself is found at the third
//! time.

use std::time::{Duration, Instant};

use proto::{ExitCode, ExitError};

use super::Session;
use crate::checkpoint::CheckpointError;
use crate::report::Reporter;
use crate::supervisor::{Cause, Death, Supervisor, log_tail};

/// How long a learner or worker may take at least until it is ready, however short the deadline is
/// for one that has been heard.
const START_DEADLINE: Duration = Duration::from_secs(10);
/// Deaths of the learner in a row, without a new iteration in between, that end the run.
const MAX_LEARNER_CRASHES: u32 = 3;
/// The same for deaths by a signal from outside.
const MAX_LEARNER_KILLS: u32 = 50;

impl Session<'_> {
    /// Reaps the dead, opens their shards again and starts successors.
    pub(super) fn bury(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        let deaths = supervisor.reap();
        if !deaths.is_empty() {
            // Once for all of them: it waits where one has died in the middle of something.
            self.channels.clean_up_after_the_dead();
        }
        for death in deaths {
            match death {
                Death::Learner(cause) => {
                    // Its last words may still be on the way.
                    self.hear_learner(supervisor, reporter)?;
                    return self.recover(cause, supervisor, reporter);
                }
                Death::Left(worker) => {
                    self.heard.remove(&worker);
                    if let Some(scheduler) = &mut self.scheduler {
                        scheduler.worker_gone(worker);
                    }
                    reporter.note(&format!("worker {worker} has left"));
                }
                Death::Worker(worker, cause) => {
                    self.heard.remove(&worker);
                    self.early.retain(|(early, _)| *early != worker);
                    let estate = self
                        .scheduler
                        .as_mut()
                        .map(|scheduler| scheduler.worker_gone(worker))
                        .unwrap_or_default();
                    // The worker was busy with the oldest; the others it had not begun.
                    if let Some((iteration, _)) = estate.undelivered.first() {
                        self.books.lost(*iteration, self.steps_per_block);
                    }
                    reporter.note(&format!(
                        "worker {worker} died ({cause}); {} open shards are ordered again",
                        estate.undelivered.len()
                    ));
                    // Who was killed from outside says nothing about the block it was making.
                    if let Some(address) = estate.at_hand
                        && !matches!(cause, Cause::Killed(_))
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
        self.learner_deaths.count(cause);
        // One that cannot even come up will not come up the next time.
        let is_hopeless = self.scheduler.is_none() && matches!(cause, Cause::Crash(_));
        if is_hopeless || self.learner_deaths.are_too_many(MAX_LEARNER_CRASHES, MAX_LEARNER_KILLS) {
            let log = self.spec.run_dir.logs().join("learner.log");
            let cure = if self.store.latest_until(self.reported).is_ok() {
                let run_dir = self.spec.run_dir.path().display();
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
        // Workers hold orders and policies of the future that is now undone.
        supervisor.kill_all();
        self.snapshots.learner_gone();
        self.hear_committer(reporter)?;
        while self.status.try_receive()?.is_some() {}
        while self.progress.try_receive()?.is_some() {}
        while self.pieces.try_receive()?.is_some() {}
        self.failures.take_policies()?;
        self.failures.forget_policies();
        self.channels.clean_up_after_the_dead();
        let received = self.scheduler.take().map_or(0, |scheduler| scheduler.received());
        self.books.all_lost(received as u64 * self.steps_per_block);
        self.early.clear();
        self.heard.clear();
        self.finishing = None;

        // A newer one is of a future that the metrics have lost, see `octopus resume`.
        let from = match self.store.latest_until(self.reported) {
            Ok(checkpoint) => Some(checkpoint),
            Err(CheckpointError::NotFound { .. }) => None,
            Err(error) => return Err(ExitError::new(ExitCode::RunDirectory, error.to_string())),
        };
        let iteration = from.as_ref().map_or(0, |checkpoint| checkpoint.manifest.iteration);
        reporter.note(&format!(
            "the learner died ({cause}); going on from iteration {iteration} of {}",
            self.reported
        ));
        reporter.rewind(iteration).map_err(|error| {
            ExitError::new(ExitCode::RunDirectory, format!("metrics cannot be rewound: {error:#}"))
        })?;
        self.learner_restarts += 1;
        self.snapshots.go_on_from(iteration);
        self.start_children(from.as_ref(), supervisor)
    }

    /// Kills who has not been heard for too long.
    pub(super) fn check_deadlines(&mut self, supervisor: &mut Supervisor, reporter: &mut Reporter) {
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
                (since.elapsed() > deadline).then_some((worker, deadline.as_secs_f64()))
            })
            .collect();
        for (worker, seconds) in silent {
            if supervisor.kill_worker(worker) {
                reporter.note(&format!(
                    "worker {worker} has been silent for {seconds} s and is replaced"
                ));
            }
        }
        let deadline = if self.scheduler.is_some() { deadline } else { start_deadline };
        if self.learner_heard.elapsed() > deadline {
            let seconds = deadline.as_secs_f64();
            reporter.note(&format!("the learner has been silent for {seconds} s and is replaced"));
            self.learner_heard = Instant::now();
            supervisor.kill_learner();
        }
    }
}
