//! `octopus rollout`: one block of a run, made again alone.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use clap::Args;
use output::grouped;
use proto::config::Config;
use proto::layout::{ActorLayout, BlockLayout, Dimensions};
use proto::message::policy_version_for;
use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use run::session::failures;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde::Serialize;
use serde_json::json;
use simulator::env::Moment;
use simulator::rollout::{RolloutError, RolloutSpec, World, rollout};
use store::checkpoint::{Checkpoint, CheckpointStore, Name, POLICY, Selector, read_policy};
use store::files;
use store::jsonl;
use store::outputs::Output;

use crate::not_the_same::NotTheSame;

const EXAMPLES: &str = "\
Examples:
  octopus rollout runs/trajectory-20260101-120000 --address 1/500/1
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
    let run_dir = store::run_files::run_directory(&args.run_dir)?;
    let chosen = args.policy.as_deref().map(open_policy).transpose()?;
    if let Some(path) = &args.out {
        let output = Output { flag: "--out", path, mark: b"", force: args.force };
        let chosen = chosen.iter().map(|checkpoint| ("--policy", checkpoint.dir.as_path()));
        let inputs: Vec<_> = chosen.chain([("RUN_DIR", args.run_dir.as_path())]).collect();
        output.check(&inputs)?;
    }
    let BlockAddress { seed, iteration, shard } = args.address;
    let config = store::run_files::read_config(&run_dir)?;
    let (robot, _) = store::run_files::read_robot(&run_dir)?;
    let world = World::new(&config, &robot);
    check_address(args, &config)?;
    let version = policy_version_for(iteration, config.run.overlap);
    let layout = ActorLayout::new(&config, &world.dimensions);
    let path = match &chosen {
        Some(checkpoint) => checkpoint.dir.join(POLICY),
        None => find_policy(args, &run_dir, &config, version)?,
    };
    let (found, parameters) = (path.display().to_string(), read_policy(&path, &layout)?);
    let policy = world
        .policy(&parameters)
        .map_err(|error| ExitError::new(ExitCode::RunDirectory, format!("{found}: {error}")))?;

    let spec = RolloutSpec { seed, iteration, shard, policy: &policy };
    let layout = BlockLayout::new(&world.dimensions);
    let mut block = vec![0.0; layout.len];
    let begun = Instant::now();
    rollout(&world, &spec, &mut block, &mut |_| {}).map_err(|error| refuse(args, &error))?;
    let seconds = begun.elapsed().as_secs_f64();
    let recorded = if chosen.is_none() { recorded(&run_dir, args.address)? } else { None };
    let summary = Summary {
        seed,
        iteration,
        shard,
        policy_version: version,
        policy: found,
        env_steps: world.block_env_steps(),
        blake3: blake3::hash(bytemuck::cast_slice(&block)).to_hex().to_string(),
        same: recorded.map(|recorded| recorded == Digest::of_block(&block)),
        recorded,
        returns: returns(&world.dimensions, &layout, &block),
        seconds,
    };
    if let Some(path) = &args.out {
        files::replace_output(path, &to_safetensors(&world.dimensions, &layout, &block)?)?;
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

/// Refuses a block that the run never makes. With a policy of one's own, any seed will do.
fn check_address(args: &RolloutArgs, config: &Config) -> Result<(), ExitError> {
    let BlockAddress { seed, iteration, shard } = args.address;
    let refuse = |what: String| {
        Err(ExitError::new(
            ExitCode::Usage,
            format!("--address {seed}/{iteration}/{shard}: {what}"),
        ))
    };
    let n_shards = config.env.n_shards as u64;
    if u64::from(shard) >= n_shards {
        return refuse(format!(
            "there is no shard {shard}: the run has {}, counted from 0",
            output::counted(n_shards, "shard")
        ));
    }
    if args.policy.is_none() && seed != config.run.seed {
        let own = config.run.seed;
        return refuse(format!(
            "the run's seed is {own}, not {seed}; with --policy any seed can be rolled out"
        ));
    }
    Ok(())
}

/// The checkpoint that `--policy` names.
fn open_policy(path: &Path) -> anyhow::Result<Checkpoint> {
    let selector =
        Selector::from_path(path).map_err(|message| ExitError::new(ExitCode::Usage, message))?;
    Ok(selector.open()?)
}

/// Where the run has kept the policy.
fn find_policy(
    args: &RolloutArgs,
    run_dir: &RunDir,
    config: &Config,
    version: u64,
) -> anyhow::Result<PathBuf> {
    let address = (args.address.iteration, args.address.shard);
    let beside = failures::directory(run_dir, address).join(POLICY);
    if beside.is_file() {
        return Ok(beside);
    }
    let store = CheckpointStore::new(run_dir.checkpoints());
    let path = store.dir(&Name::of_iteration(version)).join(POLICY);
    if path.is_file() {
        return Ok(path);
    }
    let versions = store.entries()?.into_iter().filter_map(|entry| {
        (entry.name == Name::of_iteration(entry.iteration)).then_some(entry.iteration)
    });
    let possible = reproducible(versions, config.run.overlap, config.planned_iterations());
    let possible: Vec<String> = possible.iter().map(ToString::to_string).collect();
    let possible = match possible.as_slice() {
        [] => "no iteration can be made from the checkpoints that there are".to_owned(),
        [one] => format!("only iteration {one} can be made from the checkpoints that there are"),
        all => {
            format!(
                "from the checkpoints that there are, iterations {} can be made",
                all.join(", ")
            )
        }
    };
    Err(ExitError::new(
        ExitCode::RunDirectory,
        format!(
            "{}: the policy that iteration {} acted with, version {version}, was not kept; \
             {possible}; --policy acts with another one",
            run_dir.path().display(),
            args.address.iteration,
        ),
    )
    .into())
}

/// The iterations before `planned` that acted with one of these policy versions, in order.
fn reproducible(
    versions: impl IntoIterator<Item = u64>,
    overlap: usize,
    planned: u64,
) -> BTreeSet<u64> {
    let acted = |version: u64| {
        (version..=version.saturating_add(overlap as u64))
            .filter(move |&iteration| policy_version_for(iteration, overlap) == version)
    };
    versions.into_iter().flat_map(acted).filter(|&iteration| iteration < planned).collect()
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

fn returns(dimensions: &Dimensions, layout: &BlockLayout, block: &[f32]) -> Vec<f64> {
    let per_agent = dimensions.n_steps * dimensions.n_envs;
    block[layout.reward.clone()]
        .chunks_exact(per_agent)
        .map(|rewards| {
            rewards.iter().map(|&reward| f64::from(reward)).sum::<f64>() / dimensions.n_envs as f64
        })
        .collect()
}

fn to_safetensors(
    dimensions: &Dimensions,
    layout: &BlockLayout,
    block: &[f32],
) -> anyhow::Result<Vec<u8>> {
    let Dimensions { n_agents: a, n_steps: t, n_envs: n, observation: o, state: s, .. } =
        *dimensions;
    let arrays = [
        ("observation", &layout.observation, vec![a, t + 1, n, o]),
        ("state", &layout.state, vec![t + 1, n, s]),
        ("action", &layout.action, vec![a, t, n, proto::layout::JOINTS_PER_AGENT]),
        ("log_prob", &layout.log_prob, vec![a, t, n]),
        ("reward", &layout.reward, vec![a, t, n]),
        ("terminated", &layout.terminated, vec![t, n]),
        ("truncated", &layout.truncated, vec![t, n]),
        ("metrics", &layout.metrics, vec![n, dimensions.n_metrics]),
    ];
    let views = arrays
        .into_iter()
        .map(|(name, range, shape)| {
            let bytes = bytemuck::cast_slice(&block[range.clone()]);
            Ok((name.to_owned(), TensorView::new(Dtype::F32, shape, bytes)?))
        })
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
    Ok(safetensors::serialize(views, None)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_policy_was_used_for() {
        let of = |versions: &[u64], overlap| {
            reproducible(versions.iter().copied(), overlap, 20).into_iter().collect::<Vec<_>>()
        };
        assert_eq!(of(&[5, 10, 20], 0), [5, 10], "iteration 20 would be the 21st of 20");
        assert_eq!(of(&[0, 5, 10], 1), [0, 1, 6, 11]);
        assert!(of(&[], 1).is_empty());
    }
}
