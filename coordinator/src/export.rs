//! `octopus export`: a policy for programs of others, as ONNX and as C.

use std::path::{Path, PathBuf};

use clap::Args;
use export::{HeldOut, HeldOutError, Origin, Source};
use lab::evaluation::{Summary, check_recorded};
use lab::threads::Threads;
use lab::trained::{Trained, open_checkpoint};
use output::counted;
use proto::{ExitCode, ExitError};
use serde::Serialize;
use simulator::evaluate::{EvaluationOptions, evaluate};
use store::{files, outputs};

use crate::values::whole;

const EXPORT_EXAMPLES: &str = "\
Examples:
  octopus export runs/trajectory-20260101-120000:best --out controller
  octopus export deploy/policies/trajectory --out controller --episodes 100
  cd controller && cc -std=c99 -O2 -o check check.c controller.c -lm && ./check

DIR gets controller.onnx and controller.c, which make joint rates of state and goals, policy.onnx, \
the networks alone, contract.toml, which says what every number is, and vectors.json with check.c \
and check.py, which hold both against what the simulator computed.";

/// Options of `octopus export`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXPORT_EXAMPLES)]
pub struct ExportArgs {
    /// A run directory, whose last checkpoint is taken; RUN_DIR:best for the one with the lowest
    /// score; or any other checkpoint, as `octopus checkpoints --help` lists them.
    #[arg(value_name = "RUN_DIR|CHECKPOINT")]
    pub path: PathBuf,
    /// The directory to make; it must not be there yet.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Held-out episodes for the errors that the contract gives.
    #[arg(long, value_name = "N", default_value_t = 30, allow_hyphen_values = true, value_parser = whole::<u32>(1, 1_000_000))]
    pub episodes: u32,
    /// Print what was made as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A file that was made.
#[derive(Debug, Serialize)]
struct Made {
    name: &'static str,
    bytes: usize,
}

/// What was made.
#[derive(Debug, Serialize)]
struct Report<'a> {
    out: &'a Path,
    policy: &'a Origin,
    held_out: &'a HeldOut,
    files: Vec<Made>,
}

/// Exports.
pub fn run(args: &ExportArgs) -> anyhow::Result<()> {
    let out = args.out.as_path();
    outputs::check_new_directory("--out", out)?;
    let steps = EvaluationOptions::default().steps;
    check_recorded(args.episodes as usize, steps, "--episodes")?;
    let trained = Trained::new(open_checkpoint(&args.path)?, None)?;
    let refused = export::check(&trained.world);
    refused.map_err(|why| ExitError::new(ExitCode::BadInput, why.to_string()))?;
    let origin = origin(&trained);
    let held_out = held_out(&trained, args.episodes as usize)?;
    let parameters = trained.checkpoint.actors(trained.world.robot.joints)?;
    let made = export::files(&Source {
        world: &trained.world,
        policy: &trained.policy,
        parameters: &parameters,
        origin: &origin,
        held_out: &held_out,
    })?;
    let contents: Vec<(&str, &[u8])> =
        made.iter().map(|file| (file.name, file.content.as_slice())).collect();
    files::create_directory(out, &contents)?;
    let files: Vec<Made> =
        made.iter().map(|file| Made { name: file.name, bytes: file.content.len() }).collect();
    if args.json {
        return output::json(&Report { out, policy: &origin, held_out: &held_out, files });
    }
    let errors = held_out.errors.iter().map(|HeldOutError { error, unit, mean, p90 }| {
        format!("{error} {mean:.4} {unit} (p90 {p90:.4})")
    });
    output::line(&format!(
        "{}: policy {}, {} on `{}`\n{}: {}\n\n{}",
        out.display(),
        origin.digest,
        trained.task().as_str(),
        trained.world.robot.name,
        counted(held_out.episodes as u64, "held-out episode"),
        errors.collect::<Vec<_>>().join(", "),
        output::table(
            ["file", "size"],
            files.iter().map(|file| [file.name.to_owned(), output::size(file.bytes as u64)])
        )
    ))
}

fn origin(trained: &Trained) -> Origin {
    let identity = trained.identity();
    Origin {
        checkpoint: identity.checkpoint.display().to_string(),
        digest: identity.digest.to_string(),
        policy_blake3: identity.policy_blake3,
        iterations: identity.iteration,
        env_steps: identity.env_steps,
        seed: identity.seed,
        program: env!("CARGO_PKG_VERSION").to_owned(),
    }
}

fn held_out(trained: &Trained, episodes: usize) -> anyhow::Result<HeldOut> {
    let options = EvaluationOptions { episodes, ..EvaluationOptions::default() };
    let found = evaluate(trained.player(), &options, &[], &Threads::available(), &|| {})?;
    let summary = Summary::new(&trained.identity(), options.seed, None, found, None);
    let errors = summary.overall.iter().map(|of| HeldOutError {
        error: of.error.to_string(),
        unit: of.unit.to_string(),
        mean: of.tail.mean,
        p90: of.tail.p90,
    });
    Ok(HeldOut {
        episodes,
        steps: summary.steps,
        seed: options.seed,
        episodes_with_contact: summary.episodes_with_contact,
        errors: errors.collect(),
    })
}
