//! Playing episodes of the run's own evaluation.

use proto::ExitError;
use proto::message::{EvaluationChunk, Status};

use super::process::{Worker, say_alive};

/// Plays episodes of the run's own evaluation.
pub(super) fn evaluate(worker: &mut Worker<'_>, chunk: EvaluationChunk) -> Result<(), ExitError> {
    let policy = worker.policies.iter().find(|(held, _)| *held == chunk.policy_version);
    let alive = worker.alive();
    let (status, heartbeat) = (&worker.status, &mut worker.heartbeat);
    let mut on_step = || say_alive(status, heartbeat, &alive);
    let errors = policy.map(|(_, policy)| {
        simulator::evaluate::select(worker.world, policy, chunk.first, chunk.episodes, &mut on_step)
    });
    let errors = match errors {
        Some(Ok(errors)) => errors,
        None => Vec::new(),
        Some(Err(error)) => {
            let what = format!("evaluation of policy {}: {error}", chunk.policy_version);
            worker.fail(&what, None)?;
            Vec::new()
        }
    };
    worker.send(&Status::EvaluationDone {
        worker: worker.id,
        incarnation: worker.incarnation,
        chunk,
        errors,
    })
}
