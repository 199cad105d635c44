//! How near hands and base come to held-out goals.

use proto::config::TaskName;
use serde::Serialize;
use serde_json::json;
use sim_worker::evaluate::Evaluation;

use super::lab::{Lab, Needs};
use super::report::ErrorOfMany;
use crate::cli::experiment::PrecisionArgs;
use crate::commands::eval::Summary;

/// The precision of one policy.
#[derive(Debug, Serialize)]
struct Precision {
    /// As `octopus eval --json` prints it.
    summary: Summary,
    /// Every hand's errors, or the base's, with their courses.
    errors: Vec<ErrorOfMany>,
}

/// Measures and prints.
pub(super) fn run(args: &PrecisionArgs) -> anyhow::Result<()> {
    let lab = Lab::new(&args.common, Needs::Any, None)?;
    let mut results = Vec::new();
    for policy in lab.policies() {
        let recording =
            lab.play(&format!("precision, {}", policy.task().as_str()), &lab.trial(policy))?;
        let errors = match policy.task() {
            TaskName::Trajectory => (0..lab.robot.n_arms)
                .flat_map(|arm| {
                    [
                        ErrorOfMany::position(&recording, arm),
                        ErrorOfMany::orientation(&recording, arm),
                    ]
                })
                .collect(),
            TaskName::Reorientation => vec![ErrorOfMany::base(&recording)],
        };
        let controller = lab.controller(policy)?;
        let summary = Summary::new(policy, lab.seed, Evaluation::of(&recording), controller);
        results.push(Precision { summary, errors });
    }
    let table: Vec<String> = results
        .iter()
        .map(|result| format!("{}\n{}", result.summary.task.as_str(), result.summary.table()))
        .collect();
    let settings = json!({ "goals": "held out", "tail_steps": sim_worker::experiment::TAIL_STEPS });
    lab.print("precision", settings, &results, &table.join("\n\n"))
}
