//! `octopus verify`: whether two runs, or a run and its repetition, are the same to the bit.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use lab::verification::{Record, compare, replay};
use proto::{ExitCode, ExitError};

use crate::not_the_same::NotTheSame;
use crate::values::whole;

/// Both forms of the command, also shown when neither is complete.
const USAGE: &str = "\
octopus verify [--json] RUN RUN_B
       octopus verify [--json] RUN --replay K

The first form compares two runs; the second trains iterations of RUN again, up
to iteration K, and compares.";

const PROMISE: &str = "\
Examples:
  octopus verify runs/trajectory-20260101-120000 runs/trajectory-20260102-090000
  octopus verify runs/trajectory-20260101-120000 --replay 60 --json

What is promised: with the same configuration, seed, build and processor type, the digest in \
metrics.jsonl (over all parameters, optimiser moments, normalisers and counters) is the same in \
every iteration, whatever the number of workers, the order in which they deliver, kills of any \
process, stops and resumes. Keys of the configuration that only say how many processes work, when \
the run stops and which checkpoints are kept are reported as harmless.

What is not promised: the same bits from another processor type, another build (version, commit, \
debug or release), another C library, more threads than networks (run.learner_threads), or a GPU. Where \
two runs differ in one of these, equal digests are luck and different ones no defect; the report \
names every such difference but that of C libraries.

A replay begins at the newest checkpoint of iteration K or earlier, or from nothing if there is \
none, with the configuration that RUN holds now, in a temporary directory that is removed \
afterwards. RUN is only read.

Exit code: 0 if every iteration that both have agrees, 1 if they part or a replay ended before \
iteration K, 2 if both are one directory, 5 if something is missing or damaged, 130 if a replay \
was stopped by Ctrl-C.";

/// Options of `octopus verify`.
#[derive(Debug, Clone, Args)]
#[command(override_usage = USAGE, after_help = PROMISE)]
#[command(group = ArgGroup::new("against").required(true).args(["other", "replay"]))]
pub struct VerifyArgs {
    /// The run directory.
    pub run: PathBuf,
    /// The run directory to compare it with.
    #[arg(value_name = "RUN_B")]
    pub other: Option<PathBuf>,
    /// Train again through iteration K, counted from 0 as in metrics.jsonl, and compare.
    #[arg(long, value_name = "K", allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub replay: Option<u64>,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Compares; exit code 1 if what was compared is not the same.
pub fn run(args: &VerifyArgs) -> anyhow::Result<()> {
    let record = Record::read(&args.run)?;
    let same = match (&args.other, args.replay) {
        (Some(other), _) => {
            let other = Record::read(other)?;
            if record.is_of_the_directory_of(&other) {
                let message = format!(
                    "{}: is given twice, and is the same as itself; name another run, or repeat this \
                     one by --replay K",
                    args.run.display()
                );
                return Err(ExitError::new(ExitCode::Usage, message).into());
            }
            let result = compare(&record, &other);
            if args.json {
                output::json(&result)?;
            } else {
                output::line(&result.text())?;
            }
            result.is_same()
        }
        (None, Some(iteration)) => {
            let result = replay(&record, iteration)?;
            if args.json {
                output::json(&result)?;
            } else {
                output::line(&result.text())?;
            }
            let same = result.is_same();
            if same && let Some(error) = result.ended_early() {
                return Err(error.into());
            }
            same
        }
        (None, None) => unreachable!("the command line wants one of both"),
    };
    if same { Ok(()) } else { Err(NotTheSame.into()) }
}
