//! `import` and `export`.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::os::fd::AsFd as _;
use std::path::Path;

use anyhow::Context as _;
use proto::{ExitCode, ExitError};
use run::signals::StopRequests;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use store::checkpoint::{CheckpointError, CheckpointStore, Name};
use store::outputs::Output;
use store::{regular_files, temporary};

use super::common::{refused, report, store_to_fill};
use crate::checkpoints::from_bucket::{self, Found};
use crate::checkpoints::options::{ExportArgs, ImportArgs};

/// Unpacks an archive into a store.
pub(super) fn import(args: &ImportArgs) -> anyhow::Result<()> {
    from_bucket::refuse(&args.store)?;
    let store = store_to_fill("--store", &args.store, &args.store, Some(args.force))?;
    let stop = StopRequests::new();
    stop.listen_and_insist("stopped at once").context("signals cannot be caught")?;
    let file = if args.archive == Path::new("-") {
        File::from(std::io::stdin().as_fd().try_clone_to_owned().context("no standard input")?)
    } else {
        regular_files::open(&args.archive).map_err(|error| {
            let message = format!("{}: cannot be read: {error}", args.archive.display());
            ExitError::new(ExitCode::BadInput, message)
        })?
    };
    let archive = BufReader::new(UntilStopped { file, stop: &stop });
    let imported = store.import(archive, args.name.clone());
    if imported.is_err() && stop.count() > 0 {
        let message = format!("stopped; nothing of {} is in the store", args.archive.display());
        return Err(ExitError::new(ExitCode::Interrupted, message).into());
    }
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

/// Reads until somebody asks to stop: that is an error like any other then, after which what was unpacked is removed.
struct UntilStopped<'a> {
    file: File,
    stop: &'a StopRequests,
}

/// How often to look whether somebody has, where a pipe has nothing to read.
const TICK: Timespec = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };

impl Read for UntilStopped<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        while self.stop.count() == 0 {
            match poll(&mut [PollFd::new(&self.file, PollFlags::IN)], Some(&TICK)) {
                Ok(0) | Err(Errno::INTR) => {}
                _ => return self.file.read(buffer),
            }
        }
        Err(std::io::Error::other("stopped"))
    }
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
    let temporary = temporary::beside(out);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A writer that says nothing would be waited for, for ever.
    #[test]
    fn reading_a_pipe_ends_when_somebody_asks() {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        (&writer).write_all(b"x").expect("it has room");
        let stop = StopRequests::new();
        let mut archive =
            UntilStopped { file: File::from(std::os::fd::OwnedFd::from(reader)), stop: &stop };
        let mut byte = [0; 2];
        assert_eq!(archive.read(&mut byte).expect("there is one"), 1);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(std::time::Duration::from_millis(120));
                stop.ask();
            });
            assert_eq!(archive.read(&mut byte).expect_err("stopped").to_string(), "stopped");
        });
    }
}
