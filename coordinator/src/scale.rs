//! `octopus scale`: changes the number of workers of a live run.

use std::path::PathBuf;

use clap::Args;
use proto::{ExitCode, ExitError};
use service::client::{Client, ClientError};
use service::http::Token;

use crate::values::workers_wanted;

const SCALE_EXAMPLES: &str = "\
Examples:
  octopus scale runs/trajectory-20260101-120000 8
  octopus scale runs/trajectory-20260101-120000 auto
  octopus scale runs/trajectory-20260101-120000 1 --json
  octopus scale runs/trajectory-20260101-120000 4 --token-file token.txt
  octopus scale runs/trajectory-20260101-120000 2 --host lab-2

The number of workers changes nothing that is learned. New workers start at once; surplus ones \
leave after the shards that they have begun. A run has room for 16 workers, or for twice as many \
as it was started or resumed with if that is more; one that is open to other machines can do with \
none of its own. With --host it is another machine that has so many workers from now on, until it \
leaves; `octopus status` shows names and numbers of those that help.";

/// Options of `octopus scale`.
#[derive(Debug, Clone, Args)]
#[command(after_help = SCALE_EXAMPLES)]
pub struct ScaleArgs {
    /// The run directory.
    pub run_dir: PathBuf,
    /// Workers from now on, `auto` for one a processor.
    #[arg(value_name = "N|auto", allow_negative_numbers = true, value_parser = workers_wanted)]
    pub workers: u64,
    /// Name or number of the other machine that shall have them [default: this one].
    #[arg(long, value_name = "HOST", allow_negative_numbers = true)]
    pub host: Option<String>,
    /// A file with the token to show [default: http.token of the run directory].
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Tells the run and says what changed.
pub fn run(args: &ScaleArgs) -> anyhow::Result<()> {
    let token_file = args.token_file.as_deref();
    let token = token_file.map(Token::from_file).transpose()?;
    let client = Client::of_run(&args.run_dir, token)?;
    let workers = usize::try_from(args.workers).unwrap_or(usize::MAX);
    let answer = client.scale(workers, args.host.as_deref()).map_err(|error| match error {
        // A number that the run cannot have is the command line's fault, as is a host that is not there.
        ClientError::Refused { status: 422, message } => {
            let known = if args.host.is_some() { None } else { room(&client, args.workers) };
            let message = known.unwrap_or(message);
            ExitError::new(ExitCode::Usage, message)
        }
        error => error.explained(token_file),
    })?;
    if args.json {
        return output::json(&answer);
    }
    let (before, workers) = (answer.before, output::counted(answer.workers as u64, "worker"));
    let of = args.host.as_ref().map_or_else(String::new, |host| format!(" of host {host}"));
    output::line(&if before == answer.workers {
        format!("{workers}{of}, as before")
    } else {
        format!("{workers}{of} instead of {before}")
    })
}

/// How many workers the run can have, and why not `wanted`.
fn room(client: &Client, wanted: u64) -> Option<String> {
    let status = client.status().ok()?;
    let (least, most) = (status.min_workers as u64, status.max_workers as u64);
    (!(least..=most).contains(&wanted)).then(|| {
        format!(
            "{wanted} workers cannot be had: this run can have {least} to {most}, for which it made room \
             in shared memory when it started; resumed with --workers N it makes room for 2 N, at \
             least 16"
        )
    })
}
