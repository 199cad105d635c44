//! One iteration: train on its samples, publish the policy, report.

use std::convert::Infallible;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, TryRecvError};
use std::time::{Duration, Instant};

use channels::ArraySample;
use proto::message::{IterationReport, Losses, Progress, Timing};

use super::process::{Learner, Trainer};
use crate::LearnerError;
use crate::inbox::errors;
use crate::report::UpdateReport;

/// How often it looks whether training is done.
const BUSY: Duration = Duration::from_millis(2);

/// Trains on the complete iteration, publishes, reports.
pub(super) fn iterate(learner: &mut Learner, waited: Duration) -> Result<(), LearnerError> {
    let iteration = learner.trainer.state.iteration;
    let samples = learner.ports.inbox.take();
    let policy_version = samples[0].header().policy_version;
    let rollout_ns: u64 = samples.iter().map(|sample| sample.header().rollout_ns).sum();
    let shards: Vec<&[f32]> = samples.iter().map(ArraySample::payload).collect();

    let begun = Instant::now();
    let update = train(learner, &shards)?;
    let update_s = begun.elapsed().as_secs_f64();
    let errors = errors(learner.task, &learner.dimensions, &shards);
    drop(samples);

    let state = &learner.trainer.state;
    let begun = Instant::now();
    learner.ports.publish(state.iteration, |out| state.write_policy(out))?;
    let publish_s = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    learner.digest = state.digest();
    let digest_s = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    if learner.run.plans_snapshot(learner.trainer.state.iteration) {
        // One that was asked for meanwhile would be the same.
        learner.ports.wants_snapshot = false;
        learner.take_snapshot();
    }
    let copy_s = begun.elapsed().as_secs_f64();
    let state = &learner.trainer.state;

    let mut report = report(&update);
    report.iteration = iteration;
    report.env_steps = state.env_steps;
    report.digest = learner.digest;
    report.policy_version = policy_version;
    report.errors = errors;
    report.accounting = learner.ports.inbox.account(iteration);
    report.timing = Timing {
        wait_s: waited.as_secs_f64(),
        update_s,
        publish_s,
        digest_s,
        copy_s,
        rollout_s: rollout_ns as f64 * 1e-9,
    };
    Ok(learner.ports.progress.send(&Progress::IterationDone(Box::new(report)))?)
}

/// Updates on the thread for it, and keeps receiving meanwhile.
fn train(learner: &mut Learner, shards: &[&[f32]]) -> Result<UpdateReport, LearnerError> {
    let Learner { trainer: Trainer { algorithm, state, thread }, ports, .. } = learner;
    let work = algorithm.work();
    let mut updated = None;
    // Nothing is sent: the sender goes when the update has ended, also by a panic.
    let (ends, end) = mpsc::channel::<Infallible>();
    let received = thread.in_place_scope(|scope| {
        let updated = &mut updated;
        scope.spawn(move |_| {
            let _ends = ends;
            *updated = Some(algorithm.update(state, shards));
        });
        let mut received = Ok(());
        let mut worked = work.load(Ordering::Relaxed);
        while end.try_recv() == Err(TryRecvError::Empty) {
            if received.is_ok() {
                received = ports.pump();
            }
            // An update that stands still shall be found out, so it is no sign of life that
            // this thread is well.
            let now = work.load(Ordering::Relaxed);
            if now != worked {
                worked = now;
                // Also when there is an error to tell: it is told when the update has ended.
                let beaten = ports.beat();
                received = received.and(beaten);
            }
            ports.bell.wait(BUSY);
        }
        received
    });
    received.and(updated.expect("it ended without a panic"))
}

/// What the update says, as the coordinator gets it.
fn report(update: &UpdateReport) -> IterationReport {
    let mean = |values: &[f64]| (values.iter().sum::<f64>() / values.len() as f64) as f32;
    IterationReport {
        returns: update.returns.iter().map(|&x| x as f32).collect(),
        losses: Losses {
            policy: mean(&update.policy_loss),
            value: mean(&update.value_loss),
            entropy: mean(&update.entropy),
            kl: mean(&update.kl),
            clip_fraction: mean(&update.clip_fraction),
            explained_variance: mean(&update.explained_variance),
            actor_grad_norm: mean(&update.actor_grad_norm),
            critic_grad_norm: mean(&update.critic_grad_norm),
        },
        actor_lr: update.actor_lr,
        critic_lr: update.critic_lr,
        action_std: mean(&update.action_std),
        ..IterationReport::default()
    }
}
