//! `octopus scale`: changes the number of workers of a live run.

use proto::{ExitCode, ExitError};

use crate::cli::serve::ScaleArgs;
use crate::client::{Client, ClientError};
use crate::http::Token;
use crate::output;

/// Tells the run and says what changed.
pub fn run(args: &ScaleArgs) -> anyhow::Result<()> {
    let token = Token::find(args.token_file.as_deref())?;
    let client = Client::of_run(&args.run_dir, token)?;
    let answer = client.scale(args.workers as usize).map_err(|error| match error {
        // A number that the run cannot have is the command line's fault.
        ClientError::Refused { status: 422, message } => ExitError::new(ExitCode::Usage, message),
        error => error.into(),
    })?;
    if args.json {
        return output::json(&answer);
    }
    let (before, workers) = (answer.before, answer.workers);
    output::line(&if before == workers {
        format!("{workers} workers, as before")
    } else {
        format!("{workers} workers instead of {before}")
    })
}
