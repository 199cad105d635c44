//! A membership: workers of this machine that work for a run of another one.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use channels::{ChannelSizes, Channels, Role};
use proto::config::Config;
use proto::gateway::{Place, Told};
use proto::message::Status;
use proto::{ExitCode, ExitError};

use super::gateway::{Gateway, Word};
use super::spec::{Ended, JoinSpec, Left};
use crate::deadlines::START_DEADLINE;
use crate::loop_clock::LoopClock;
use crate::preflight;
use crate::supervisor::{Death, Supervisor};

/// How long the loop sleeps at most: bounds the time until a death is noticed.
const TICK: Duration = Duration::from_millis(20);

/// A membership that has begun.
pub(super) struct Host<'a> {
    pub(super) spec: &'a JoinSpec,
    pub(super) config: &'a Config,
    /// How many workers there are to be.
    pub(super) workers: usize,
    /// When each worker was last heard.
    pub(super) heard: BTreeMap<u32, Instant>,
    pub(super) blocks: &'a mut u64,
}

impl Host<'_> {
    pub(super) fn serve(
        &mut self,
        channels: &Channels,
        place: &Place,
        gateway: &mut Gateway,
        supervisor: &mut Supervisor,
        note: &mut dyn FnMut(&str),
    ) -> Result<Ended, ExitError> {
        let bell = channels.listener(Role::Coordinator)?;
        let words = channels.status_receiver()?;
        gateway.tell(place);
        supervisor.scale(self.spec.workers)?;
        let mut clock = LoopClock::new(Instant::now());
        loop {
            bell.wait(TICK);
            let late = clock.turn(Instant::now());
            if !late.is_zero() {
                // Nobody was heard meanwhile, and nobody is to blame for that.
                self.heard.values_mut().for_each(|heard| *heard += late);
                supervisor.postpone_deadlines(late);
            }
            while let Some(status) = words.try_receive()? {
                self.hear(&status, gateway, supervisor, note);
            }
            self.replace_the_dead(clock.now(), channels, supervisor, note)?;
            match gateway.wait(Duration::ZERO) {
                None | Some(Word::Joined(_)) => {}
                Some(Word::Scale(workers)) => {
                    let sizes = channels.sizes();
                    self.scale(workers as usize, sizes, gateway, supervisor, note)?;
                }
                Some(Word::Ended(ExitCode::Success, _)) => return Ok(Ended::Left(Left::Over)),
                // It may be better the next time, but not where this machine lacks something.
                Some(Word::Ended(ExitCode::Environment, why)) => {
                    return Err(ExitError::new(ExitCode::Environment, why));
                }
                Some(Word::Ended(_, why)) => return Ok(Ended::Lost(why)),
            }
            if self.spec.stop.count() > 0 {
                return Ok(Ended::Left(Left::Asked));
            }
        }
    }

    /// The run wants another number of workers.
    fn scale(
        &mut self,
        workers: usize,
        sizes: &ChannelSizes,
        gateway: &mut Gateway,
        supervisor: &mut Supervisor,
        note: &mut dyn FnMut(&str),
    ) -> Result<(), ExitError> {
        let before = self.workers;
        if let Err(why) = preflight::scale(sizes, before, workers) {
            note(&format!("the run wants {workers} workers, and {before} stay: {why}"));
            return Ok(());
        }
        self.workers = workers;
        for (worker, incarnation) in supervisor.scale(workers)? {
            self.heard.remove(&worker);
            gateway.tell(&Told::Leave { worker, incarnation });
        }
        let wanted = output::counted(workers as u64, "worker");
        note(&format!("the run wants {wanted} of this machine, before {before}"));
        Ok(())
    }

    fn hear(
        &mut self,
        status: &Status,
        gateway: &mut Gateway,
        supervisor: &mut Supervisor,
        note: &mut dyn FnMut(&str),
    ) {
        match status {
            // It has not heard that it shall go.
            Status::Ready { worker, incarnation, .. }
            | Status::Heartbeat { worker, incarnation, .. }
                if supervisor.is_leaving(*worker, *incarnation) =>
            {
                gateway.tell(&Told::Leave { worker: *worker, incarnation: *incarnation });
            }
            Status::Ready { worker, incarnation, .. }
            | Status::Heartbeat { worker, incarnation, .. }
                if supervisor.is_current(*worker, *incarnation) =>
            {
                self.heard.insert(*worker, Instant::now());
            }
            Status::BlockDone { worker, .. } | Status::EvaluationDone { worker, .. } => {
                *self.blocks += 1;
                self.heard.insert(*worker, Instant::now());
                supervisor.worker_delivered(*worker);
            }
            Status::Failed { worker, message, .. } => note(&format!("worker {worker}: {message}")),
            _ => {}
        }
    }

    /// Reaps the dead, kills the silent and starts successors; the gateway sends them what is left undone.
    fn replace_the_dead(
        &mut self,
        now: Instant,
        channels: &Channels,
        supervisor: &mut Supervisor,
        note: &mut dyn FnMut(&str),
    ) -> Result<(), ExitError> {
        let deaths = supervisor.reap();
        if !deaths.is_empty() {
            channels.clean_up_after_the_dead();
        }
        for death in deaths {
            match death {
                Death::Worker(worker, cause) => {
                    self.heard.remove(&worker);
                    note(&format!("worker {worker} died ({cause}) and is replaced"));
                    supervisor.check_deaths(worker, cause)?;
                }
                Death::Left(worker) => {
                    self.heard.remove(&worker);
                    note(&format!("worker {worker} has left"));
                }
                Death::Learner(_) | Death::Gateway(_) => {}
            }
        }
        supervisor.start_due()?;
        let deadline = Duration::from_secs_f64(self.config.run.order_deadline_s);
        let silent: Vec<_> = supervisor
            .running_since()
            .filter(|(worker, started)| match self.heard.get(worker) {
                Some(heard) => now.saturating_duration_since(*heard) > deadline,
                None => now.saturating_duration_since(*started) > deadline.max(START_DEADLINE),
            })
            .map(|(worker, _)| worker)
            .collect();
        for worker in silent {
            if supervisor.kill_worker(worker) {
                note(&format!("worker {worker} has been silent for too long"));
            }
        }
        Ok(())
    }
}
