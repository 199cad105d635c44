//! `octopus checkpoints`: the checkpoint service on the command line.

mod commit;
mod compose;
mod inspect;
mod keep;
mod label;
mod listing;
mod transfer;

use proto::{ExitCode, ExitError};

use crate::checkpoint::{CheckpointError, Entry};
use crate::cli::checkpoints::{CheckpointsArgs, CheckpointsCommand};
use crate::output;

/// Does what the command line says.
pub fn run(args: &CheckpointsArgs) -> anyhow::Result<()> {
    match &args.command {
        CheckpointsCommand::List(args) => listing::list(args),
        CheckpointsCommand::Show(args) => listing::show(args),
        CheckpointsCommand::Verify(args) => inspect::verify(args),
        CheckpointsCommand::Diff(args) => inspect::diff(args),
        CheckpointsCommand::Pin(args) => label::pin(args, true),
        CheckpointsCommand::Unpin(args) => label::pin(args, false),
        CheckpointsCommand::Tag(args) => label::tag(args),
        CheckpointsCommand::Untag(args) => label::untag(args),
        CheckpointsCommand::Prune(args) => keep::prune(args),
        CheckpointsCommand::Rebuild(args) => keep::rebuild(args),
        CheckpointsCommand::Delete(args) => keep::delete(args),
        CheckpointsCommand::Commit(args) => commit::commit(args),
        CheckpointsCommand::Import(args) => transfer::import(args),
        CheckpointsCommand::Export(args) => transfer::export(args),
        CheckpointsCommand::Compose(args) => compose::compose(args),
    }
}

/// Gives what was refused, and changed nothing, an exit code of its own: nothing is damaged.
fn refused(code: ExitCode) -> impl Fn(CheckpointError) -> anyhow::Error {
    move |error| match error {
        CheckpointError::Refused { reason } => ExitError::new(code, reason).into(),
        other => other.into(),
    }
}

/// Prints a checkpoint as JSON, or what became of it in words.
fn report(entry: &Entry, json: bool, done: &str) -> anyhow::Result<()> {
    if json {
        return output::json(entry);
    }
    output::line(&format!("{}: {done}", entry.dir.display()))
}
