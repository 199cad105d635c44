//! `octopus eval`: how well a policy does on goals it never saw.

use std::path::{Path, PathBuf};

use clap::Args;
use lab::contender::Contender;
use lab::evaluation::{EPISODES_OR_STEPS, check_recorded, evaluate_on};
use lab::goals::{self, OwnGoals};
use lab::identity::ControllerName;
use lab::trained::{Trained, open_checkpoint};
use output::grouped;
use proto::config::TaskName;
use simulator::evaluate::EvaluationOptions;
use simulator::experiment::EvaluationGoals;
use simulator::step::StepOptions;
use store::files;
use store::outputs::{Input, Output};

use crate::names::Named;
use crate::values::whole;

const EVAL_EXAMPLES: &str = "\
Examples:
  octopus eval runs/trajectory-20260101-120000
  octopus eval runs/trajectory-20260101-120000:best
  octopus eval runs/trajectory-20260101-120000:500 --episodes 200
  octopus eval runs/trajectory-20260101-120000 --json | jq .overall
  octopus eval runs/a --save-goals goals.csv
  octopus eval runs/a --goals goals.csv
  octopus eval --controller jacobian --episodes 300 --seed 5

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
    #[arg(value_name = "RUN_DIR|CHECKPOINT", required_unless_present = "controller")]
    pub path: Option<PathBuf>,
    /// A controller that is not learned, instead of a policy.
    #[arg(
        long,
        allow_negative_numbers = true,
        value_enum,
        value_name = "NAME",
        conflicts_with = "path"
    )]
    pub controller: Option<Named<ControllerName>>,
    /// The controller's task.
    #[arg(long, allow_negative_numbers = true, value_enum, value_name = "TASK", default_value_t = Named(TaskName::Trajectory), conflicts_with = "path")]
    pub task: Named<TaskName>,
    /// The controller's robot: `paper`, `release`, or a robot file.
    #[arg(
        long,
        allow_negative_numbers = true,
        value_name = "NAME|FILE",
        default_value = "paper",
        conflicts_with = "path"
    )]
    pub robot: String,
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
    let contender = contender(args)?;
    let read = |path: &PathBuf| OwnGoals::read(path, contender.world.robot.n_arms);
    let own = args.goals.as_ref().map(read).transpose()?;
    let episodes = match &own {
        Some(own) => {
            own.check(std::iter::once(contender.task()))?;
            own.episodes(args.episodes)?
        }
        None => args.episodes.unwrap_or(30),
    };
    let (seed, episodes, steps) = (args.seed, episodes as usize, args.steps as usize);
    check_recorded(episodes, steps, EPISODES_OR_STEPS)?;
    if let Some(path) = &args.save_goals {
        let mut inputs: Vec<Input<'_>> = vec![("--robot", Path::new(&args.robot))];
        inputs.extend(args.path.as_deref().map(|path| ("RUN_DIR|CHECKPOINT", path)));
        inputs.extend(args.goals.as_deref().map(|path| ("--goals", path)));
        Output { flag: "--save-goals", path, mark: b"", force: args.force }.check(&inputs)?;
        let given = own.as_ref().map_or(&[][..], |own| &own.given);
        let drawn = EvaluationGoals { seed, given };
        files::replace_output(path, &goals::write(path, &contender.world, drawn, episodes)?)?;
    }
    let options = EvaluationOptions { seed, episodes, steps };
    let summary = evaluate_on(&contender, &options, own.as_ref())?;
    if args.json {
        return output::json(&summary);
    }
    let table = summary.table(output::columns(), args.agents);
    let what = contender.shown();
    if summary.controller.is_some() {
        return output::line(&format!("{what}, {}\n\n{table}", summary.task.as_str()));
    }
    let (iteration, env_steps) = (summary.iteration, grouped(summary.env_steps));
    output::line(&format!("{what}\niteration {iteration}, {env_steps} env-steps\n\n{table}"))
}

/// What is evaluated.
fn contender(args: &EvalArgs) -> anyhow::Result<Contender> {
    match (&args.path, args.controller) {
        (Some(path), _) => Ok(Trained::new(open_checkpoint(path)?, None)?.into()),
        (None, Some(name)) => {
            let robot = run::robots::load_fit_robot(&args.robot, &StepOptions::default())?;
            Contender::controller(name.0, args.task.0, &robot)
        }
        (None, None) => unreachable!("the command line wants one of both"),
    }
}
