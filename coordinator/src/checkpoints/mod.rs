//! `octopus checkpoints`: the checkpoint service on the command line.

pub(crate) mod common;
mod compose;
pub(crate) mod from_bucket;
mod inspect;
mod keep;
mod label;
mod listing;
pub mod options;
mod request_commit;
mod transfer;

use crate::checkpoints::options::{CheckpointsArgs, CheckpointsCommand};

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
        CheckpointsCommand::Commit(args) => request_commit::commit(args),
        CheckpointsCommand::Import(args) => transfer::import(args),
        CheckpointsCommand::Export(args) => transfer::export(args),
        CheckpointsCommand::Compose(args) => compose::compose(args),
    }
}
