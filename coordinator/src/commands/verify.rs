//! `octopus verify`: whether two runs, or a run and its repetition, are the same to the bit.

use lab::verification::{Record, compare, replay};

use crate::cli::verify::VerifyArgs;
use super::NotTheSame;

/// Compares; exit code 1 if what was compared is not the same.
pub fn run(args: &VerifyArgs) -> anyhow::Result<()> {
    let record = Record::read(&args.run)?;
    let same = match (&args.other, args.replay) {
        (Some(other), _) => {
            let other = Record::read(other)?;
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
