//! The learner loop: receive, answer, train.

use std::time::{Duration, Instant};

use proto::message::Progress;

use super::iteration::iterate;
use super::process::Learner;
use crate::LearnerError;

/// How often a learner with nothing to do looks for workers that came late.
const IDLE: Duration = Duration::from_millis(20);
/// How often it looks whether there is room for a snapshot's next piece.
const BUSY: Duration = Duration::from_millis(2);

/// Receives, and trains whenever an iteration is complete, until it is told to stop.
pub(super) fn serve(learner: &mut Learner) -> Result<(), LearnerError> {
    announce(learner)?;
    let mut idle_since = Instant::now();
    loop {
        learner.ports.pump()?;
        learner.ports.beat()?;
        if learner.ports.wants_snapshot {
            learner.ports.wants_snapshot = false;
            learner.take_snapshot();
        }
        if learner.ports.wants_stop {
            return Ok(());
        }
        if learner.ports.inbox.is_complete() {
            iterate(learner, idle_since.elapsed())?;
            idle_since = Instant::now();
        } else {
            let busy = !learner.ports.outbox.is_empty();
            learner.ports.bell.wait(if busy { BUSY } else { IDLE });
        }
    }
}

/// Publishes the policies that workers begin with, and says what it begins from.
fn announce(learner: &Learner) -> Result<(), LearnerError> {
    let Learner { trainer, ports, run, digest, .. } = learner;
    let state = &trainer.state;
    if run.overlap > 0 && state.iteration > 0 {
        // Workers that overlap act with the version before the newest.
        let previous = &state.previous_policy;
        ports.publish(state.iteration - 1, |out| out.copy_from_slice(previous))?;
    }
    ports.publish(state.iteration, |out| state.write_policy(out))?;
    let precision = state.arithmetic.as_str();
    ports.progress.send(&Progress::Ready {
        iteration: state.iteration,
        env_steps: state.env_steps,
        digest: *digest,
        precision: precision.to_owned(),
        orders: ports.orders.port(),
    })?;
    tracing::info!(iteration = state.iteration, %digest, precision, "ready");
    Ok(())
}
