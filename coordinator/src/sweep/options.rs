//! What is asked of a sweep on the command line.

use std::path::PathBuf;

use clap::Args;

use crate::values::whole;

const EXAMPLES: &str = "\
Examples:
  octopus sweep deploy/sweeps/initial-noise.toml --dry-run
  octopus sweep deploy/sweeps/initial-noise.toml
  octopus sweep deploy/sweeps/initial-noise.toml --table
  octopus sweep rates.toml --out sweeps/rates --jobs 4 --json
  octopus sweep rates.toml --trial $SLURM_ARRAY_TASK_ID

A file says what is tried:
  iterations = 500               # of each trial; or env_steps = 2e6
  seeds = [0, 1, 2]              # each configuration with each of them
  [grid]                         # every combination; [[trials]] for a list
  algorithm.gamma = [0.93, 0.95]
  optimizer.actor_lr = [3e-4, 5e-4]
  [halving]                      # drops configurations on the way:
  rungs = [0.25, 0.5]            # after these shares of the budget
  reduction = 2                  # the best half goes on

It may also say task, preset, algorithm and config, as `octopus train` takes them, [set] with keys \
of all trials, jobs, and [evaluation] with episodes, steps and seed of the evaluation at the end.

A trial is a run in OUT/trials. Its score is the mean of the errors in the last 20 steps of \
episodes with held-out goals, in units of the paper's accuracy: less is better. At a rung \
configurations are compared by the mean over their seeds. Schedules run over the whole budget from \
the beginning, so a trial that went on is the same, to the bit, as one that never paused.

One Ctrl-C lets every trial finish its iteration and commit a checkpoint; a second one stops \
within three seconds. The same command goes on, also after a crash or a kill. Trials may be added to the file \
meanwhile; what has begun may not change. In the end OUT has table.csv and report.html.";

/// Options of `octopus sweep`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct SweepArgs {
    /// What is tried: a TOML file.
    pub file: PathBuf,
    /// Where everything lands, and goes on [default: sweeps/NAME, for a file NAME.toml].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Trials at a time [default: as the file says, or as many as there are processors for].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<usize>(1, 1000))]
    pub jobs: Option<usize>,
    /// Do this trial alone, as --dry-run counts them, as far as the scores of the others allow.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<usize>(1, 1_000_000), conflicts_with_all = ["dry_run", "table"])]
    pub trial: Option<usize>,
    /// Check everything, list the trials and what they cost, and train nothing.
    #[arg(long, conflicts_with = "table")]
    pub dry_run: bool,
    /// Show how far it is, and train nothing.
    #[arg(long)]
    pub table: bool,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}
