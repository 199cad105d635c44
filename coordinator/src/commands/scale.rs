//! `octopus scale`: changes the number of workers of a live run.

use proto::{ExitCode, ExitError};

use crate::cli::serve::ScaleArgs;
use crate::client::{Client, ClientError};
use crate::output;

/// Tells the run and says what changed.
pub fn run(args: &ScaleArgs) -> anyhow::Result<()> {
    let client = Client::of_run(&args.run_dir)?;
    let answer = client.scale(args.workers as usize).map_err(|error| match error {
        // A number that the run cannot have is the command line's fault.
        ClientError::Refused { status: 422, message } => ExitError::new(ExitCode::Usage, message),
        ClientError::Refused { status: 401, message } => ExitError::new(
            ExitCode::Usage,
            format!("{message}; set SPACEOCTOPUS_TOKEN to the token of the run"),
        ),
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
