//! Options of `octopus reproduce`.

use std::path::PathBuf;

use clap::Args;

use super::values::whole;

const EXAMPLES: &str = "\
Examples:
  octopus reproduce --quick
  octopus reproduce --policies trained --out reproduction
  octopus reproduce --policies trained --runs runs/a-1 runs/a-2 runs/a-3

All experiments of the paper with the policies DIR/trajectory and DIR/reorientation. The directory of
--out gets a JSON file an experiment, as `octopus experiment EXPERIMENT --json` prints it, and
report.html: one page with the paper's claims beside what was measured, and the paper's figures. A
claim that fails is printed, and is no error. Called again with the same --out, it does only what is
not there yet; files that are damaged, or were made with other settings, policies or another build,
are refused.";

/// Options of `octopus reproduce`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct ReproduceArgs {
    /// A directory that holds `trajectory` and `reorientation` [default: deploy/policies, where it exists].
    #[arg(long, value_name = "DIR")]
    pub policies: Option<PathBuf>,
    /// Run directories whose learning curves the page shows, seeds of one algorithm together.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub runs: Vec<PathBuf>,
    /// Where everything goes [default: reproduction-YYYYMMDD-HHMMSS].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Fewer episodes and fewer settings, in a third of the time.
    #[arg(long)]
    pub quick: bool,
    /// Episodes of a setting [default: as in the experiments; 10 with --quick].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole::<u32>(1, 1_000_000))]
    pub episodes: Option<u32>,
    /// Control steps of an episode.
    #[arg(long, value_name = "N", default_value_t = 200, allow_negative_numbers = true, value_parser = whole::<u32>(1, 100_000))]
    pub steps: u32,
    /// Seed of goals and noise.
    #[arg(long, value_name = "S", default_value_t = 0, allow_negative_numbers = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Print the claims as JSON.
    #[arg(long)]
    pub json: bool,
}
