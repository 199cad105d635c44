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
bit: the robot's state of a recording; observations, states of critics, rewards and ends of \
episodes of a block.

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
        ("recording", replay_motion(&Recorded::read(&bytes).map_err(bad)?)?)
    } else {
        let block = Block::read(&bytes).map_err(|what| {
            bad(format!("is no recording (MCAP) and no block that can be played again: {what}"))
        })?;
        let threads = Threads::available();
        ("block", replay_block(&block, &threads, threads.count())?)
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
    let steps = output::counted(*steps as u64, "control step");
    match first {
        None => format!("{kind}: the same, all {} numbers of {steps}", grouped(*numbers)),
        Some(first) => format!(
            "{kind}: differs after control step {} of {steps}, first in\n  {}\n  recorded  {}\n  replayed  {}",
            first.step, first.what, first.recorded, first.replayed
        ),
    }
}
