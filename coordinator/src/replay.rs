//! `octopus replay`: what was kept, played again.

use std::path::PathBuf;

use clap::Args;
use export::{Block, Recorded, Recording, Replay, replay_block, replay_motion};
use lab::threads::Threads;
use output::grouped;
use proto::{ExitCode, ExitError};
use serde::Serialize;
use store::regular_files;

use crate::not_the_same::NotTheSame;

const EXAMPLES: &str = "\
Examples:
  octopus record deploy/policies/trajectory --out reach.mcap
  octopus replay reach.mcap
  octopus rollout runs/a --address 1/500/0 --out block.safetensors
  octopus replay block.safetensors --json

The file says where the robot began and what was commanded. That is played again in this \
program's simulator, and every number after every control step is held against the file, bit by \
bit: the robot's state of a recording, whose messages for viewers must have their checksums; \
observations, states of critics, rewards and ends of episodes of a block.

Exit code: 0 if all bits are the same, 1 if one differs, 3 if the file is none of these.";

/// Options of `octopus replay`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct ReplayArgs {
    /// A recording of `octopus record`, or a block of `octopus rollout --out`.
    #[arg(value_name = "FILE.mcap|BLOCK.safetensors")]
    pub file: PathBuf,
    /// Print what came of it as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Longest file that is read (bytes).
const LONGEST: u64 = 8 << 30;

/// What came of it.
#[derive(Debug, Serialize)]
struct Report {
    /// `recording` or `block`.
    kind: &'static str,
    same: bool,
    #[serde(flatten)]
    replay: Replay,
}

/// Plays it again; exit code 1 if a bit differs.
pub fn run(args: &ReplayArgs) -> anyhow::Result<()> {
    let shown = args.file.display();
    let bad = |what: String| ExitError::new(ExitCode::BadInput, format!("{shown}: {what}"));
    let bytes = regular_files::read(&args.file, LONGEST)
        .map_err(|error| bad(format!("cannot be read: {error}")))?;
    let (kind, replay) = if bytes.starts_with(Recording::MARK) {
        let recorded = Recorded::read(&bytes).map_err(bad)?;
        ("recording", replay_motion(&recorded).map_err(|error| bad(error.to_string()))?)
    } else {
        let block = Block::read(&bytes).map_err(|what| {
            bad(format!("is no recording (MCAP) and no block that can be played again: {what}"))
        })?;
        let threads = Threads::available();
        // What cannot be played is the file's fault: what it begins from and what was done are in it.
        let replay = replay_block(&block, &threads, threads.count());
        ("block", replay.map_err(|error| bad(error.to_string()))?)
    };
    let report = Report { kind, same: replay.first.is_none(), replay };
    if args.json {
        output::json(&report)?;
    } else {
        output::line(&text(&report))?;
    }
    if report.same { Ok(()) } else { Err(NotTheSame.into()) }
}

fn text(report: &Report) -> String {
    let Report { kind, replay: Replay { steps, numbers, first }, .. } = report;
    let of = if *kind == "recording" { " of the robot's states" } else { "" };
    let steps = output::counted(*steps as u64, "control step");
    match first {
        None => format!("{kind}: the same, all {} numbers{of} in {steps}", grouped(*numbers)),
        Some(first) => format!(
            "{kind}: differs after control step {} of {steps}, first in\n  {}\n  recorded  {}\n  replayed  {}",
            first.step, first.what, first.recorded, first.replayed
        ),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use export::BlockAddress;
    use proto::config::{Layers, Preset, TaskName};
    use simulator::policy::initial_parameters;
    use simulator::robot::Robot;
    use simulator::rollout::{RolloutSpec, World, rollout};

    use super::*;

    #[test]
    fn a_block_that_cannot_be_played_is_bad_input_and_named() {
        let layers = Layers::new(Preset::Tuned, Some(TaskName::Trajectory));
        let set = ["network.hidden=[8]", "task.episode_steps=5", "env.n_envs=12", "env.n_shards=4"];
        let layers = set.iter().try_fold(layers, |layers, set| layers.set(set)).expect("keys");
        let config = layers.resolve().expect("valid");
        let world = World::new(&config, &Robot::builtin("paper").expect("built in"));
        let parameters = initial_parameters(&world.config, &world.dimensions, 3);
        let policy = world.policy(&parameters).expect("a policy");
        let mut numbers = vec![0.0; world.block_layout().len];
        let spec = RolloutSpec { seed: 4, iteration: 1, shard: 0, policy: &policy };
        rollout(&world, &spec, &mut numbers, &mut |_| {}).expect("a block");
        numbers[world.block_layout().action.start] = f32::NAN;
        let address = BlockAddress { seed: 4, iteration: 1, shard: 0 };
        let block = Block { world: Arc::new(world), address, numbers };
        let place = tempfile::tempdir().expect("tempdir");
        let file = place.path().join("block.safetensors");
        std::fs::write(&file, block.write().expect("a file")).expect("written");
        let error = run(&ReplayArgs { file, json: false }).expect_err("an action is no number");
        let error = error.downcast::<ExitError>().expect("with its exit code");
        assert_eq!(error.code, ExitCode::BadInput);
        assert!(error.message.contains("block.safetensors: "), "{}", error.message);
        assert!(error.message.contains("is NaN, expected a finite number"), "{}", error.message);
    }
}
