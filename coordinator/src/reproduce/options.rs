//! What is asked of a reproduction on the command line.

use std::path::PathBuf;

use clap::Args;
use lab::identity::ControllerName;
use proto::config::AlgorithmName;

use crate::names::Named;
use crate::values::{assignment, whole};

const EXAMPLES: &str = "\
Examples:
  octopus reproduce --quick
  octopus reproduce --policies trained --out reproduction
  octopus reproduce --policies trained --runs runs/a-1 runs/a-2 runs/a-3
  octopus reproduce --train --out reproduction
  octopus reproduce --train --seeds 1 --baselines ppo --out short \\
      --set run.env_steps=400000

All experiments of the paper with the policies DIR/trajectory and DIR/reorientation. The \
directory of --out gets a JSON file an experiment, as `octopus experiment EXPERIMENT --json` \
prints it, and report.html: one page with the paper's claims beside what was measured, and the \
paper's figures. A claim that fails is printed, and is no error. Called again with the same \
--out, it does only what is not there yet; files that are damaged, or were made with other \
settings, policies or another build, are refused.

With --train, runs land in OUT/runs, and those that were stopped go on; the policies are those of \
the MAPPO runs whose best checkpoints have the lowest scores, and land in OUT/policies.";

/// Options of `octopus reproduce`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of the command line")]
pub struct ReproduceArgs {
    /// A directory that holds `trajectory` and `reorientation`, perhaps `robust`, too: a policy that learned with a robot that errs [default: deploy/policies, here or above the program].
    #[arg(long, value_name = "DIR")]
    pub policies: Option<PathBuf>,
    /// A controller that is not learned, instead of policies: the yardstick beside which they stand.
    #[arg(long, allow_negative_numbers = true, value_enum, value_name = "NAME", conflicts_with_all = ["policies", "runs", "train"])]
    pub controller: Option<Named<ControllerName>>,
    /// Run directories whose learning curves the page shows, seeds of one algorithm together, or files of
    /// `octopus plot --save` [default: curves.json beside the policies, where it exists].
    #[arg(long, value_name = "DIR|CURVES", num_args = 1..)]
    pub runs: Vec<PathBuf>,
    /// Train everything first, from nothing; takes hours.
    #[arg(long, conflicts_with_all = ["policies", "runs"], help_heading = "Training")]
    pub train: bool,
    /// Runs of each algorithm and task, with the seeds 1 to N; the best one of MAPPO gives the policy.
    #[arg(long, value_name = "N", default_value_t = 3, requires = "train", conflicts_with_all = ["policies", "runs", "controller"], allow_hyphen_values = true, value_parser = whole::<u64>(1, 1000), help_heading = "Training")]
    pub seeds: u64,
    /// What MAPPO is compared with. Without a value: nothing, only MAPPO is trained.
    #[arg(long, allow_negative_numbers = true, value_name = "LIST", value_enum, num_args = 0.., default_value = "ppo,maddpg", value_delimiter = ',', requires = "train", conflicts_with_all = ["policies", "runs", "controller"], help_heading = "Training")]
    pub baselines: Vec<Named<AlgorithmName>>,
    /// Change one key of all trainings; may be given again: --set run.env_steps=4000000.
    #[arg(long = "set", value_name = "KEY=VALUE", allow_hyphen_values = true, value_parser = assignment, requires = "train", conflicts_with_all = ["policies", "runs", "controller"], help_heading = "Training")]
    pub sets: Vec<String>,
    /// Where everything goes [default: reproduction-YYYYMMDD-HHMMSS].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Take a directory that holds other things, too; never a run's.
    #[arg(long)]
    pub force: bool,
    /// Fewer episodes and fewer settings, in a third of the time.
    #[arg(long)]
    pub quick: bool,
    /// Episodes of a setting [default: as in the experiments; 10 with --quick].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u32>(1, 1_000_000))]
    pub episodes: Option<u32>,
    /// Control steps of an episode.
    #[arg(long, value_name = "N", default_value_t = 200, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000))]
    pub steps: u32,
    /// Seed of goals and noise.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Print the claims as JSON.
    #[arg(long)]
    pub json: bool,
}
