//! `octopus eval`: how well a policy does on goals it never saw.

use std::path::PathBuf;

use clap::Args;
use lab::evaluation::evaluate;
use lab::trained::open_checkpoint;
use output::grouped;
use simulator::evaluate::EvaluationOptions;

use crate::values::whole;

const EVAL_EXAMPLES: &str = "\
Examples:
  octopus eval runs/trajectory-20260101-120000
  octopus eval runs/trajectory-20260101-120000:best
  octopus eval runs/trajectory-20260101-120000:500 --episodes 200
  octopus eval runs/trajectory-20260101-120000 --json | jq .overall

Of every episode three numbers are taken for each error: its minimum over time (`min`), its value \
after the last step (`final`) and its mean over the last 20 steps (`tail`).";

/// Options of `octopus eval`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EVAL_EXAMPLES)]
pub struct EvalArgs {
    /// A run directory, whose last checkpoint is taken; RUN_DIR:best for the one with the lowest
    /// score; or any other checkpoint, as `octopus checkpoints --help` lists them.
    #[arg(value_name = "RUN_DIR|CHECKPOINT")]
    pub path: PathBuf,
    /// Episodes, each with a goal of its own.
    #[arg(long, value_name = "N", default_value_t = 30, allow_hyphen_values = true, value_parser = whole::<u32>(1, 1_000_000))]
    pub episodes: u32,
    /// Control steps of an episode.
    #[arg(long, value_name = "N", default_value_t = 200, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000))]
    pub steps: u32,
    /// Seed of the goals.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Show the errors of each agent, too.
    #[arg(long)]
    pub agents: bool,
    /// Print the result as JSON, every episode included.
    #[arg(long)]
    pub json: bool,
}

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
