//! `octopus eval`: how well a policy does on goals it never saw.

use lab::evaluation::evaluate;
use lab::trained::open_checkpoint;
use output::grouped;
use simulator::evaluate::EvaluationOptions;

use crate::cli::EvalArgs;

/// Evaluates.
pub fn run(args: &EvalArgs) -> anyhow::Result<()> {
    let checkpoint = open_checkpoint(&args.path)?;
    let options = EvaluationOptions {
        seed: args.seed,
        episodes: args.episodes as usize,
        steps: args.steps as usize,
    };
    let summary = evaluate(checkpoint, &options)?;
    if args.json {
        return output::json(&summary);
    }
    output::line(&format!(
        "{}\niteration {}, {} env-steps\n\n{}",
        summary.checkpoint.display(),
        summary.iteration,
        grouped(summary.env_steps),
        summary.table(output::columns(), args.agents)
    ))
}
