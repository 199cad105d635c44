//! `octopus record`: an episode for robot viewers.

use std::path::{Path, PathBuf};

use clap::Args;
use export::Recording;
use lab::trained::{Trained, open_checkpoint};
use proto::{ExitCode, ExitError};
use serde::Serialize;
use simulator::experiment::{Member, Start};
use store::files;
use store::outputs::{Output, is_same_place};

use crate::values::whole;

const RECORD_EXAMPLES: &str = "\
Examples:
  octopus record runs/trajectory-20260101-120000:best --out reach.mcap
  octopus record deploy/policies/trajectory --out reach.mcap --episode 3 \\
      --csv reach.csv
  octopus urdf --robot paper --out robot.urdf

The robot plays an episode of `octopus eval`. The file holds its frames, joints, commands, goals, \
errors and contacts after every control step, as messages that Foxglove and Rerun know, and the \
robot as the attachment robot.urdf.";

/// Options of `octopus record`.
#[derive(Debug, Clone, Args)]
#[command(after_help = RECORD_EXAMPLES)]
pub struct RecordArgs {
    /// A run directory, whose last checkpoint is taken; RUN_DIR:best for the one with the lowest
    /// score; or any other checkpoint, as `octopus checkpoints --help` lists them.
    #[arg(value_name = "RUN_DIR|CHECKPOINT")]
    pub policy: PathBuf,
    /// The recording, an MCAP file.
    #[arg(long, value_name = "FILE.mcap")]
    pub out: PathBuf,
    /// The same as columns, with a header.
    #[arg(long, value_name = "FILE.csv")]
    pub csv: Option<PathBuf>,
    /// Write over files that are there already, and into a run's directory; what is read stays.
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

/// What a recording begins with.
const MARK: &[u8] = b"\x89MCAP0\r\n";
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
    let inputs: [(&'static str, &Path); 1] = [("RUN_DIR|CHECKPOINT", &args.policy)];
    Output { flag: "--out", path: &args.out, mark: MARK, force: args.force }.check(&inputs)?;
    if let Some(path) = &args.csv {
        Output { flag: "--csv", path, mark: CSV_MARK, force: args.force }.check(&inputs)?;
        if is_same_place(path, &args.out) {
            let message = format!("--csv {}: is what --out writes", path.display());
            return Err(ExitError::new(ExitCode::Usage, message).into());
        }
    }
    let trained = Trained::new(open_checkpoint(&args.policy)?, None)?;
    let identity = trained.identity();
    let origin = [
        ("checkpoint", identity.checkpoint.display().to_string()),
        ("digest", identity.digest.to_string()),
        ("env_steps", identity.env_steps.to_string()),
    ];
    let member = Member { world: trained.world, policy: trained.policy };
    let start = Start { seed: args.seed, episode: args.episode, ..Start::default() };
    let recording = Recording::play(member, start, args.steps as usize, &origin)?;
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
