//! `octopus record`: a motion for robot viewers.

use std::path::{Path, PathBuf};

use clap::Args;
use export::{BlockAddress, Commanded, Recording, block_start};
use lab::trained::{Trained, open_checkpoint};
use proto::{ExitCode, ExitError};
use serde::Serialize;
use simulator::executor::InOrder;
use simulator::experiment::{FixedGoals, Member, Start};
use simulator::state::State;
use simulator::step::StepOptions;
use store::files;
use store::outputs::{self, Input, Output};

use crate::blocks::{BlockSource, address, open_policy};
use crate::joint_commands;
use crate::trajectories::last_state;
use crate::values::whole;

const USAGE: &str = "\
octopus record [OPTIONS] --out <FILE.mcap> <RUN_DIR|CHECKPOINT>
       octopus record [OPTIONS] --out <FILE.mcap> <RUN_DIR> --address <BLOCK>
       octopus record [OPTIONS] --out <FILE.mcap> --plan <PLAN.csv>";

const RECORD_EXAMPLES: &str = "\
Examples:
  octopus record runs/trajectory-20260101-120000:best --out reach.mcap
  octopus record deploy/policies/trajectory --out reach.mcap --episode 3 \\
      --csv reach.csv
  octopus record runs/trajectory-20260101-120000 --address 1/100/1 --env 3 \\
      --out block.mcap
  octopus record --plan plan.csv --out plan.mcap
  octopus replay reach.mcap

The robot plays an episode of `octopus eval`, or what a worker's environment did in a block of a \
run, or executes a plan. The file holds its frames, joints, commands, goals, errors and contacts \
after every control step, as messages that Foxglove and Rerun know, and the robot as the \
attachment robot.urdf. `octopus replay` plays it again and compares every bit.";

/// Options of `octopus record`.
#[derive(Debug, Clone, Args)]
#[command(override_usage = USAGE, after_help = RECORD_EXAMPLES)]
pub struct RecordArgs {
    /// A run directory, whose last checkpoint is taken; RUN_DIR:best for the one with the lowest
    /// score; or any other checkpoint, as `octopus checkpoints --help` lists them.
    #[arg(value_name = "RUN_DIR|CHECKPOINT", required_unless_present = "plan")]
    pub source: Option<PathBuf>,
    /// A block of the run instead of an episode: its exploration, its start, its goals.
    #[arg(long, value_name = "SEED/ITERATION/SHARD", allow_hyphen_values = true, value_parser = address, conflicts_with_all = ["seed", "episode", "steps"])]
    pub address: Option<BlockAddress>,
    /// Which environment of the block, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u32>(0, 999_999), requires = "address", conflicts_with_all = ["seed", "episode", "steps", "plan"])]
    pub env: u32,
    /// A checkpoint whose policy makes the block, instead of the run's own.
    #[arg(long, value_name = "RUN_DIR|CHECKPOINT", requires = "address", conflicts_with_all = ["seed", "episode", "steps", "plan"])]
    pub policy: Option<PathBuf>,
    /// Commands that `octopus plan` has written, instead of a policy's.
    #[arg(long, value_name = "PLAN.csv", conflicts_with_all = ["source", "address", "seed", "episode", "steps"])]
    pub plan: Option<PathBuf>,
    /// The plan's robot: `paper`, `release`, or a robot file.
    #[arg(
        long,
        allow_negative_numbers = true,
        value_name = "NAME|FILE",
        default_value = "paper",
        requires = "plan",
        conflicts_with_all = ["source", "address", "seed", "episode", "steps"]
    )]
    pub robot: String,
    /// The plan begins where the trajectory in this file ends, instead of at home.
    #[arg(long, value_name = "FILE.csv", requires = "plan", conflicts_with_all = ["source", "address", "seed", "episode", "steps"])]
    pub state: Option<PathBuf>,
    /// The recording, an MCAP file.
    #[arg(long, value_name = "FILE.mcap")]
    pub out: PathBuf,
    /// The same as columns, with a header.
    #[arg(long, value_name = "FILE.csv")]
    pub csv: Option<PathBuf>,
    /// Write over files of another kind, too, and into a run's directory; what is read stays. A file of
    /// this command's own kind is replaced without it.
    #[arg(long)]
    pub force: bool,
    /// Seed of the goals.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// Which episode of that seed, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u32>(0, 999_999))]
    pub episode: u32,
    /// Control steps.
    #[arg(long, value_name = "N", default_value_t = 200, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000))]
    pub steps: u32,
    /// Print what was made as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What its columns begin with.
const CSV_MARK: &[u8] = b"t,base_x,base_y,base_z,base_qw,";

/// What was made.
#[derive(Debug, Serialize)]
struct Report<'a> {
    out: &'a Path,
    csv: Option<&'a Path>,
    bytes: usize,
    steps: usize,
    seconds: f64,
}

/// Records.
pub fn run(args: &RecordArgs) -> anyhow::Result<()> {
    let mut inputs: Vec<Input<'_>> = Vec::new();
    inputs.extend(args.source.as_deref().map(|path| ("RUN_DIR|CHECKPOINT", path)));
    inputs.extend(args.policy.as_deref().map(|path| ("--policy", path)));
    inputs.extend(args.plan.as_deref().map(|path| ("--plan", path)));
    inputs.extend(args.state.as_deref().map(|path| ("--state", path)));
    inputs.push(("--robot", Path::new(&args.robot)));
    Output { flag: "--out", path: &args.out, mark: Recording::MARK, force: args.force }
        .check(&inputs)?;
    if let Some(path) = &args.csv {
        Output { flag: "--csv", path, mark: CSV_MARK, force: args.force }.check(&inputs)?;
        outputs::check_distinct(&[("--out", &args.out), ("--csv", path)])?;
    }
    let recording = match (&args.source, args.address, &args.plan) {
        (Some(run_dir), Some(address), _) => of_block(run_dir, address, args)?,
        (Some(policy), None, _) => of_episode(policy, args)?,
        (None, _, Some(plan)) => of_plan(plan, args)?,
        (None, _, None) => unreachable!("the command line wants one of both"),
    };
    let file = recording.mcap()?;
    let (steps, seconds) = recording.length();
    files::replace_output(&args.out, &file)?;
    if let Some(path) = &args.csv {
        files::replace_output(path, &recording.csv()?)?;
    }
    if args.json {
        let (out, csv, bytes) = (args.out.as_path(), args.csv.as_deref(), file.len());
        return output::json(&Report { out, csv, bytes, steps, seconds });
    }
    output::line(&format!(
        "{}: {steps} control steps, {seconds:.1} s, {}",
        args.out.display(),
        output::size(file.len() as u64)
    ))
}

/// An episode of `octopus eval`.
fn of_episode(policy: &Path, args: &RecordArgs) -> anyhow::Result<Recording> {
    let trained = Trained::new(open_checkpoint(policy)?, None)?;
    let identity = trained.identity();
    let origin = [
        ("task", trained.task().as_str().to_owned()),
        ("seed", args.seed.to_string()),
        ("episode", args.episode.to_string()),
        ("checkpoint", identity.checkpoint.display().to_string()),
        ("digest", identity.digest.to_string()),
        ("env_steps", identity.env_steps.to_string()),
    ];
    let member = Member { world: trained.world, policy: trained.policy };
    let start = Start { seed: args.seed, episode: args.episode, ..Start::default() };
    let commanded = Commanded::by_policy(member, start, args.steps as usize)?;
    Ok(Recording::of(commanded, &origin)?)
}

/// What an environment did in a block of a run.
fn of_block(run_dir: &Path, address: BlockAddress, args: &RecordArgs) -> anyhow::Result<Recording> {
    let chosen = args.policy.as_deref().map(open_policy).transpose()?;
    let source = BlockSource::open(run_dir, address, chosen.as_ref())?;
    let world = &source.world;
    let BlockAddress { seed, iteration, shard } = address;
    let (env, n_envs) = (args.env as usize, world.dimensions.n_envs);
    if env >= n_envs {
        let message = format!(
            "--env {env}: a block of this run has {}, counted from 0",
            output::counted(n_envs as u64, "environment")
        );
        return Err(ExitError::new(ExitCode::Usage, message).into());
    }
    let failed = |error: &dyn std::fmt::Display| ExitError::new(ExitCode::Child, error.to_string());
    let block = source.make().map_err(|error| failed(&error))?;
    let start = block_start(&block, env, &InOrder)?;
    let rows: Vec<Vec<f32>> =
        (0..world.dimensions.n_steps).map(|step| block.executed(env, step)).collect();
    let origin = [
        ("task", world.task.name.as_str().to_owned()),
        ("block", format!("{seed}/{iteration}/{shard}")),
        ("environment", env.to_string()),
        ("policy", source.found.clone()),
    ];
    let commanded = Commanded::by_actions(world, start, rows.iter().map(Vec::as_slice));
    Ok(Recording::of(commanded, &origin)?)
}

/// What a plan commands.
fn of_plan(plan: &Path, args: &RecordArgs) -> anyhow::Result<Recording> {
    let options = StepOptions::default();
    let robot = run::robots::load_fit_robot(&args.robot, &options)?;
    let from = match &args.state {
        Some(path) => last_state(path, &robot)?,
        None => State::home(&robot),
    };
    let commands = joint_commands::read(plan, robot.n_joints())?;
    let single = |row: Vec<f64>| row.into_iter().map(|rate| rate as f32).collect();
    let mut start = State::<f32>::home(&robot);
    start.set_lane(0, &from);
    let commanded = Commanded {
        robot,
        options,
        start,
        goals: FixedGoals::default(),
        moved_goals: Vec::new(),
        mass_factors: Vec::new(),
        commands: commands.into_iter().map(single).collect(),
    };
    Ok(Recording::of(commanded, &[("plan", plan.display().to_string())])?)
}
