//! Options of `octopus rollout`.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;

const EXAMPLES: &str = "\
Examples:
  octopus rollout runs/trajectory-20260101-120000 --address 1/500/1
  octopus rollout runs/a --address 1/500/0 --out block.safetensors

A rollout is a pure function of seed, iteration, shard and policy, so this makes the very block \
that a worker of the run made, to the bit. The policy is looked for beside the block, if it \
failed in the run, then among the run's checkpoints. A block that cannot be made ends with exit \
code 6, and what is known about its environment is printed.";

/// Options of `octopus rollout`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct RolloutArgs {
    /// The run directory.
    pub run_dir: PathBuf,
    /// Which block.
    #[arg(long, value_name = "SEED/ITERATION/SHARD", allow_hyphen_values = true)]
    pub address: BlockAddress,
    /// A checkpoint whose policy to act with, instead of the run's own.
    #[arg(long, value_name = "RUN_DIR|CHECKPOINT")]
    pub policy: Option<PathBuf>,
    /// Write the block's arrays there, as safetensors.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write over a file that is there already, and into a run's directory; what is read stays.
    #[arg(long)]
    pub force: bool,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What, with a policy, determines a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BlockAddress {
    /// Seed of the run.
    pub seed: u64,
    /// The iteration.
    pub iteration: u64,
    /// The shard.
    pub shard: u32,
}

impl FromStr for BlockAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "wants SEED/ITERATION/SHARD, such as 1/500/1".to_owned();
        let mut parts = text.split('/');
        let mut next = || parts.next().ok_or_else(wrong);
        let (seed, iteration, shard) = (next()?, next()?, next()?);
        if parts.next().is_some() {
            return Err(wrong());
        }
        Ok(Self {
            seed: seed.parse().map_err(|_| wrong())?,
            iteration: iteration.parse().map_err(|_| wrong())?,
            shard: shard.parse().map_err(|_| wrong())?,
        })
    }
}
