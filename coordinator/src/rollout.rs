//! `octopus rollout`: one block of a run, made again alone.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use export::BlockAddress;
use output::grouped;
use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use serde::Serialize;
use serde_json::json;
use simulator::env::Moment;
use simulator::rollout::RolloutError;
use store::files;
use store::jsonl;
use store::outputs::Output;

use crate::blocks::{BlockSource, address, open_policy};
use crate::not_the_same::NotTheSame;

const EXAMPLES: &str = "\
Examples:
  octopus rollout runs/trajectory-20260101-120000 --address 1/100/1
  octopus rollout runs/a --address 1/500/0 --out block.safetensors

A rollout is a pure function of seed, iteration, shard and policy, so this makes the very block \
that a worker of the run made, to the bit, and says whether its digest is the one that the learner recorded (exit code 1 if not). The policy is looked for beside the block, if it \
failed in the run, then among the run's checkpoints. A block that cannot be made ends with exit \
code 6, and what is known about its environment is printed.";

/// Options of `octopus rollout`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct RolloutArgs {
    /// The run directory.
    pub run_dir: PathBuf,
    /// Which block.
    #[arg(long, value_name = "SEED/ITERATION/SHARD", allow_hyphen_values = true, value_parser = address)]
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

/// What a block is.
#[derive(Debug, Serialize)]
struct Summary {
    seed: u64,
    iteration: u64,
    shard: u32,
    policy_version: u64,
    /// Where the policy was found.
    policy: String,
    env_steps: u64,
    /// BLAKE3 of the block's numbers.
    blake3: String,
    /// How it begins according to the run's metrics; none if the run has recorded none, or for another policy's block.
    recorded: Option<Digest>,
    /// Whether it is the block that the run recorded.
    same: Option<bool>,
    /// Undiscounted return of an episode, mean over environments, an agent each.
    returns: Vec<f64>,
    seconds: f64,
}

/// Makes the block.
pub fn run(args: &RolloutArgs) -> anyhow::Result<()> {
    let chosen = args.policy.as_deref().map(open_policy).transpose()?;
    if let Some(path) = &args.out {
        let output = Output { flag: "--out", path, mark: b"", force: args.force };
        let chosen = chosen.iter().map(|checkpoint| ("--policy", checkpoint.dir.as_path()));
        let inputs: Vec<_> = chosen.chain([("RUN_DIR", args.run_dir.as_path())]).collect();
        output.check(&inputs)?;
    }
    let own = chosen.is_none();
    let source = BlockSource::open(&args.run_dir, args.address, chosen.as_ref())?;
    let begun = Instant::now();
    let block = source.make().map_err(|error| refuse(args, &error))?;
    let seconds = begun.elapsed().as_secs_f64();
    let BlockAddress { seed, iteration, shard } = args.address;
    let world = &source.world;
    let recorded = if own {
        recorded(&store::run_files::run_directory(&args.run_dir)?, args.address)?
    } else {
        None
    };
    let summary = Summary {
        seed,
        iteration,
        shard,
        policy_version: source.version,
        policy: source.found.clone(),
        env_steps: world.block_env_steps(),
        blake3: blake3::hash(bytemuck::cast_slice(&block.numbers)).to_hex().to_string(),
        same: recorded.map(|recorded| recorded == Digest::of_block(&block.numbers)),
        recorded,
        returns: world.mean_returns(&block.numbers),
        seconds,
    };
    if let Some(path) = &args.out {
        files::replace_output(path, &block.write().map_err(anyhow::Error::msg)?)?;
    }
    if args.json {
        output::json(&summary)?;
    } else {
        output::line(&text(&summary))?;
    }
    if summary.same == Some(false) { Err(NotTheSame.into()) } else { Ok(()) }
}

/// As a person reads it.
fn text(summary: &Summary) -> String {
    let Summary { seed, iteration, shard, policy_version, seconds, .. } = summary;
    let same = match summary.same {
        Some(true) => "\n            as the learner recorded it",
        Some(false) => {
            "\n            another one than the learner trained on: the policy, config.toml, robot.toml \
                        or metrics.jsonl was changed, or this program simulates otherwise"
        }
        None => "",
    };
    let mean = summary.returns.iter().sum::<f64>() / summary.returns.len().max(1) as f64;
    format!(
        "block       seed {seed}, iteration {iteration}, shard {shard}\n\
         policy      version {policy_version}, {}\n\
         env-steps   {} in {seconds:.3} s\n\
         return      {mean:.3}\n\
         blake3      {}{same}",
        summary.policy,
        grouped(summary.env_steps),
        summary.blake3,
    )
}

/// The digest that the run's learner recorded of the block; none if it recorded none.
fn recorded(run_dir: &RunDir, address: BlockAddress) -> anyhow::Result<Option<Digest>> {
    let lines = jsonl::read(&run_dir.metrics_jsonl())?;
    let mut lines = lines.iter().filter(|(_, line)| line["iteration"] == address.iteration);
    let digest = lines.next().and_then(|(_, line)| line["blocks"].get(address.shard as usize));
    Ok(digest.and_then(|digest| digest.as_str()?.parse().ok()))
}

/// The block cannot be made: says why, and prints the environment.
fn refuse(args: &RolloutArgs, error: &RolloutError) -> anyhow::Error {
    let failure = match error {
        RolloutError::Episode { source, .. } => {
            let environment = source.moment().map(Moment::arrays);
            let report = json!({
                "message": error.to_string(),
                "environment_index": source.env(),
                "step": source.step(),
                "environment": environment,
            });
            let printed = if args.json {
                output::json(&report)
            } else {
                let arrays = environment.into_iter().flatten();
                let lines = arrays.map(|(name, values)| format!("{name:28} {values:?}"));
                output::line(&lines.collect::<Vec<_>>().join("\n"))
            };
            if let Err(error) = printed {
                return error;
            }
            ExitCode::Child
        }
        // Not a failure of the block, but of the address.
        _ => ExitCode::Usage,
    };
    ExitError::new(failure, error.to_string()).into()
}
