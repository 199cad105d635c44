//! `octopus eval`: how well a policy does on goals it never saw.

use std::path::PathBuf;

use clap::Args;
use lab::evaluation::evaluate_on;
use lab::goals::{self, OwnGoals};
use lab::trained::{Trained, open_checkpoint};
use output::grouped;
use simulator::evaluate::EvaluationOptions;
use simulator::experiment::EvaluationGoals;
use store::files;
use store::outputs::{Input, Output};

use crate::values::whole;

const EVAL_EXAMPLES: &str = "\
Examples:
  octopus eval runs/trajectory-20260101-120000
  octopus eval runs/trajectory-20260101-120000:best
  octopus eval runs/trajectory-20260101-120000:500 --episodes 200
  octopus eval runs/trajectory-20260101-120000 --json | jq .overall
  octopus eval runs/a --save-goals goals.csv
  octopus eval runs/a --goals goals.csv

Of every episode three numbers are taken for each error: its minimum over time (`min`), its value \
after the last step (`final`) and its mean over the last 20 steps (`tail`).

A file of goals has a row an episode and columns hand1_x, _y, _z (m), _a, _b, _c (rad) to \
hand4_c, or base_a, base_b, base_c (rad), all in the world; a goal that it leaves out is drawn. \
As JSON: [{\"hands\": [[x, y, z, a, b, c], null, …]}, {\"base\": [a, b, c]}, …].";

/// Options of `octopus eval`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EVAL_EXAMPLES)]
pub struct EvalArgs {
    /// A run directory, whose last checkpoint is taken; RUN_DIR:best for the one with the lowest
    /// score; or any other checkpoint, as `octopus checkpoints --help` lists them.
    #[arg(value_name = "RUN_DIR|CHECKPOINT")]
    pub path: PathBuf,
    /// Episodes, each with goals of its own [default: 30, or as many as --goals has].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u32>(1, 1_000_000))]
    pub episodes: Option<u32>,
    /// Control steps of an episode.
    #[arg(long, value_name = "N", default_value_t = 200, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000))]
    pub steps: u32,
    /// Seed of the goals.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Goals of your own instead of held-out ones, a row an episode.
    #[arg(long, value_name = "FILE.csv|FILE.json")]
    pub goals: Option<PathBuf>,
    /// Write the goals there, in the form that --goals reads.
    #[arg(long, value_name = "FILE.csv|FILE.json")]
    pub save_goals: Option<PathBuf>,
    /// Write over a file of goals that is there already; what is read stays.
    #[arg(long, requires = "save_goals")]
    pub force: bool,
    /// Show the errors of each agent, too.
    #[arg(long)]
    pub agents: bool,
    /// Print the result as JSON, every episode included.
    #[arg(long)]
    pub json: bool,
}

/// Evaluates.
pub fn run(args: &EvalArgs) -> anyhow::Result<()> {
    let trained = Trained::new(open_checkpoint(&args.path)?, None)?;
    let read = |path: &PathBuf| OwnGoals::read(path, trained.world.robot.n_arms);
    let own = args.goals.as_ref().map(read).transpose()?;
    let episodes = match &own {
        Some(own) => {
            own.check(std::iter::once(trained.task()))?;
            own.episodes(args.episodes)?
        }
        None => args.episodes.unwrap_or(30),
    };
    let (seed, episodes, steps) = (args.seed, episodes as usize, args.steps as usize);
    if let Some(path) = &args.save_goals {
        let mut inputs: Vec<Input<'_>> = vec![("RUN_DIR|CHECKPOINT", &args.path)];
        inputs.extend(args.goals.as_deref().map(|path| ("--goals", path)));
        Output { flag: "--save-goals", path, mark: b"", force: args.force }.check(&inputs)?;
        let given = own.as_ref().map_or(&[][..], |own| &own.given);
        let drawn = EvaluationGoals { seed, given };
        files::replace_output(path, &goals::write(path, &trained.world, drawn, episodes)?)?;
    }
    let options = EvaluationOptions { seed, episodes, steps };
    let summary = evaluate_on(&trained, &options, own.as_ref())?;
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
