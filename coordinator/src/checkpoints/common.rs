//! What commands about checkpoints share.

use std::path::Path;

use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use store::checkpoint::{CATALOGUE, CheckpointError, CheckpointStore, Entry, store_to_be};
use store::{files, outputs};

/// Gives what was refused, and changed nothing, an exit code of its own: nothing is damaged.
pub(crate) fn refused(code: ExitCode) -> impl Fn(CheckpointError) -> anyhow::Error {
    move |error| match error {
        CheckpointError::Refused { reason } => ExitError::new(code, reason).into(),
        other => other.into(),
    }
}

/// The store at `path` that a checkpoint is about to be put into, named by `flag`, which is given `named`. A directory that holds other
/// things and no checkpoint becomes a store by `force` only, if that can be given; and none does inside a run or a
/// checkpoint.
pub(crate) fn store_to_fill(
    flag: &str,
    named: &Path,
    path: &Path,
    force: Option<bool>,
) -> anyhow::Result<CheckpointStore> {
    let store = store_to_be(path)?;
    let root = store.root();
    // What is only served may be a store that nobody changes.
    if force.is_some() {
        files::try_directory(root).map_err(|error| {
            let (named, root) = (named.display(), root.display());
            let message = format!("{flag} {named}: cannot be written: {root}: {error}");
            ExitError::new(ExitCode::Failure, message)
        })?;
    }
    let is_store = root.join(CATALOGUE).exists() || !store.survey()?.is_empty();
    if is_store || root != path || is_of_a_run(root) {
        return Ok(store);
    }
    outputs::check_outside(flag, path)?;
    if force == Some(true) {
        return Ok(store);
    }
    let entries = std::fs::read_dir(root).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    // What a store hides does not make it somebody's.
    let Some(other) = names.filter(|name| !name.starts_with('.')).min() else { return Ok(store) };
    let forced = if force.is_some() { ", or use --force" } else { "" };
    let holds = if named == path { String::new() } else { format!(" {}", path.display()) };
    let message = format!(
        "{flag} {}:{holds} holds {other:?} and no checkpoint; name a directory of checkpoints or a new one\
         {forced}",
        named.display()
    );
    Err(ExitError::new(ExitCode::RunDirectory, message).into())
}

/// Prints a checkpoint as JSON, or what became of it in words.
pub(crate) fn report(entry: &Entry, json: bool, done: &str) -> anyhow::Result<()> {
    if json {
        return output::json(entry);
    }
    output::line(&format!("{}: {done}", entry.dir.display()))
}

/// Whether a run keeps its checkpoints in `root`, which need not exist.
fn is_of_a_run(root: &Path) -> bool {
    let Some(parent) = root.parent() else { return false };
    // A relative path, or one through a link.
    let whole = root.canonicalize().ok();
    let whole = whole.as_deref().and_then(|root| Some((root, root.parent()?)));
    let is = |(root, parent): (&Path, &Path)| {
        let run = RunDir::new(parent);
        run.checkpoints() == root && run.config().is_file()
    };
    is((root, parent)) || whole.is_some_and(is)
}
