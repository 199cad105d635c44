//! `import` and `export`.

use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;

use proto::{ExitCode, ExitError};
use store::checkpoint::{CheckpointError, CheckpointStore, Name};
use store::outputs::Output;
use store::{files, regular_files};

use super::common::{refused, report, store_to_fill};
use crate::checkpoints::from_bucket::{self, Found};
use crate::checkpoints::options::{ExportArgs, ImportArgs};

/// Unpacks an archive into a store.
pub(super) fn import(args: &ImportArgs) -> anyhow::Result<()> {
    from_bucket::refuse(&args.store)?;
    let store = store_to_fill("--store", &args.store, Some(args.force))?;
    let name = args.name.clone();
    let imported = if args.archive == Path::new("-") {
        store.import(std::io::stdin().lock(), name)
    } else {
        let file = regular_files::open(&args.archive).map_err(|error| {
            let message = format!("{}: cannot be read: {error}", args.archive.display());
            ExitError::new(ExitCode::BadInput, message)
        })?;
        store.import(BufReader::new(file), name)
    };
    let entry = imported.map_err(|error| match error {
        // The archive is the input file here; nothing of the store is damaged.
        CheckpointError::Archive { .. } => {
            let message = format!("{}: {error}", args.archive.display());
            anyhow::Error::from(ExitError::new(ExitCode::BadInput, message))
        }
        other => refused(ExitCode::BadInput)(other),
    })?;
    report(&entry, args.json, "imported")
}

/// Packs a checkpoint into an archive.
pub(super) fn export(args: &ExportArgs) -> anyhow::Result<()> {
    let found = Found::of(&args.checkpoint)?;
    let (store, name) = (&found.store, &found.name);
    if args.out == Path::new("-") {
        return output::written(pack(store, name, &mut BufWriter::new(std::io::stdout().lock()))?);
    }
    let output = Output { flag: "--out", path: &args.out, mark: b"", force: args.force };
    output.check(&[("CHECKPOINT", &store.dir(name))])?;
    write(store, name, &args.out)?;
    report(&found.entry()?, args.json, &format!("exported to {}", args.out.display()))
}

/// Packs a checkpoint into `writer`; what that says to it stands apart from what is wrong with the checkpoint.
fn pack(
    store: &CheckpointStore,
    name: &Name,
    writer: &mut dyn Write,
) -> Result<std::io::Result<()>, CheckpointError> {
    match store.export(name, writer) {
        Err(CheckpointError::Io { action: "export", source, .. }) => Ok(Err(source)),
        packed => packed.map(Ok),
    }
}

/// Writes the archive beside its place first: a reader finds a whole one or none.
fn write(store: &CheckpointStore, name: &Name, out: &Path) -> anyhow::Result<()> {
    let failed = |error: &dyn std::fmt::Display| {
        let message = format!("{}: cannot be written: {error}", out.display());
        ExitError::new(ExitCode::Failure, message)
    };
    let pack = |writer: &mut dyn Write| -> anyhow::Result<()> {
        Ok(pack(store, name, writer)?.map_err(|error| failed(&error))?)
    };
    if std::fs::metadata(out).is_ok_and(|there| !there.is_file()) {
        // `/dev/stdout`, a pipe: written to as it is.
        let file = File::options().write(true).open(out).map_err(|error| failed(&error))?;
        return pack(&mut BufWriter::new(file));
    }
    let temporary = files::temporary(out);
    let written = (|| {
        let file = File::create(&temporary).map_err(|error| failed(&error))?;
        pack(&mut BufWriter::new(&file))?;
        file.sync_all().map_err(|error| failed(&error))?;
        std::fs::rename(&temporary, out).map_err(|error| failed(&error))?;
        Ok(())
    })();
    if written.is_err() {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&temporary);
    }
    written
}
