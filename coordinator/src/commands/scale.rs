//! `octopus scale`: changes the number of workers of a live run.

use proto::{ExitCode, ExitError};
use service::client::{Client, ClientError};
use service::http::Token;

use crate::cli::serve::ScaleArgs;

/// Tells the run and says what changed.
pub fn run(args: &ScaleArgs) -> anyhow::Result<()> {
    let token_file = args.token_file.as_deref();
    let token = token_file.map(Token::from_file).transpose()?;
    let client = Client::of_run(&args.run_dir, token)?;
    let workers = usize::try_from(args.workers).unwrap_or(usize::MAX);
    let answer = client.scale(workers).map_err(|error| match error {
        // A number that the run cannot have is the command line's fault.
        ClientError::Refused { status: 422, message } => {
            let message = room(&client, args.workers).unwrap_or(message);
            ExitError::new(ExitCode::Usage, message)
        }
        error => error.explained(token_file),
    })?;
    if args.json {
        return output::json(&answer);
    }
    let (before, workers) = (answer.before, output::counted(answer.workers as u64, "worker"));
    output::line(&if before == answer.workers {
        format!("{workers}, as before")
    } else {
        format!("{workers} instead of {before}")
    })
}

/// How many workers the run can have, and why not `wanted`.
fn room(client: &Client, wanted: u64) -> Option<String> {
    let most = client.status().ok()?.max_workers as u64;
    (!(1..=most).contains(&wanted)).then(|| {
        format!(
            "{wanted} workers cannot be had: this run can have 1 to {most}, for which it made room \
             in shared memory when it started; resumed with --workers N it makes room for 2 N, at \
             least 16"
        )
    })
}
