//! What comes in: orders and policies.

use channels::ChannelError;
use proto::message::Order;
use proto::{ExitCode, ExitError};

use super::assignment::{Assignment, Block};
use super::process::{Worker, failure};

/// Policy versions that a worker keeps: with overlap it acts with the one before the newest.
const KEPT_POLICIES: usize = 3;

/// Takes in all orders that have come for this worker.
pub(super) fn take_orders(worker: &mut Worker<'_>) -> Result<(), ExitError> {
    loop {
        match worker.orders.try_receive() {
            Ok(None) => return Ok(()),
            Ok(Some(Order::Rollout {
                worker: to,
                incarnation,
                iteration,
                policy_version,
                shards,
            })) if (to, incarnation) == (worker.id, worker.incarnation) => {
                for shard in shards {
                    add(worker, Assignment::Rollout(Block { iteration, policy_version, shard }));
                }
            }
            Ok(Some(Order::Evaluate { worker: to, incarnation, episodes }))
                if (to, incarnation) == (worker.id, worker.incarnation) =>
            {
                add(worker, Assignment::Evaluation(episodes));
            }
            Ok(Some(Order::Leave { worker: to, incarnation }))
                if (to, incarnation) == (worker.id, worker.incarnation) =>
            {
                worker.stopping = true;
            }
            Ok(Some(Order::Stop(_))) => worker.stopping = true,
            Ok(Some(_)) => {}
            // A garbled message is reported and passed over; its order will be sent again.
            Err(error @ ChannelError::Decode { .. }) => worker.fail(&error.to_string(), None)?,
            Err(error) => return Err(failure(&error)),
        }
    }
}

/// A re-sent order for what still waits is the same order.
fn add(worker: &mut Worker<'_>, assignment: Assignment) {
    if !worker.assignments.contains(&assignment) {
        worker.assignments.push_back(assignment);
    }
}

/// Takes in all policies that have come; keeps the newest versions.
pub(super) fn take_policies(worker: &mut Worker<'_>) -> Result<(), ExitError> {
    while let Some(sample) = worker.policy.try_receive().map_err(|error| failure(&error))? {
        let version = sample.header().version;
        match worker.world.policy(sample.payload()) {
            Ok(policy) => {
                worker.policies.retain(|(held, _)| *held != version);
                worker.policies.push_back((version, policy));
                worker.policies.make_contiguous().sort_by_key(|(held, _)| *held);
                while worker.policies.len() > KEPT_POLICIES {
                    worker.policies.pop_front();
                }
            }
            Err(error) => {
                // Who waits for a policy that it cannot use waits for ever. A successor gets it anew; who dies
                // again and again ends the run.
                let what = format!("policy version {version}: {error}");
                worker.fail(&what, None)?;
                return Err(ExitError::new(ExitCode::Failure, what));
            }
        }
    }
    Ok(())
}
