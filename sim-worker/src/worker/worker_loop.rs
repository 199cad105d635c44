//! The worker loop: take what has come, do what there is to do, say that it is alive.

use std::time::Duration;

use proto::ExitError;
use proto::message::{HEARTBEAT, Status};

use super::assignment::Assignment;
use super::block::{Delivery, make_block};
use super::evaluation::evaluate;
use super::process::Worker;
use super::receive::{take_orders, take_policies};

/// Pause before a block is made again that no learner was there to take.
const RETRY: Duration = Duration::from_millis(50);

/// Works until it is told to stop.
pub(super) fn serve(worker: &mut Worker<'_>) -> Result<(), ExitError> {
    worker.send(&Status::Ready {
        worker: worker.id,
        incarnation: worker.incarnation,
        orders: worker.orders.port(),
    })?;
    loop {
        take_orders(worker)?;
        take_policies(worker)?;
        // "Finish what is at hand": the block being made was finished before this line.
        if worker.stopping {
            return Ok(());
        }
        match next_assignment(worker) {
            Some(Assignment::Rollout(block)) => match make_block(worker, block)? {
                Delivery::Done => {}
                Delivery::Unclaimed => {
                    worker.assignments.push_back(Assignment::Rollout(block));
                    worker.bell.wait(RETRY);
                }
            },
            Some(Assignment::Evaluation(chunk)) => evaluate(worker, chunk)?,
            None => worker.bell.wait(HEARTBEAT),
        }
        worker.beat()?;
    }
}

/// The first assignment whose policy is here. Those whose policy will come wait for it; evaluations
/// whose policy is gone for good are next, too, to be answered.
fn next_assignment(worker: &mut Worker<'_>) -> Option<Assignment> {
    let held = |version: u64| worker.policies.iter().any(|(held, _)| *held == version);
    let oldest = worker.policies.front().map_or(0, |(held, _)| *held);
    let index = worker.assignments.iter().position(|assignment| {
        let version = assignment.policy_version();
        held(version) || (matches!(assignment, Assignment::Evaluation(_)) && version < oldest)
    })?;
    worker.assignments.remove(index)
}
