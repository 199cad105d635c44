//! Programs that a measurement runs: ended with it, also when it fails or is stopped.

use std::fs::File;
use std::io::Read as _;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::Context as _;
use proto::{ExitCode, ExitError};
use run::supervisor::{child_exit_code, log_tail};

use super::context::Bench;

/// How often a program is asked whether it has ended: seldom enough to cost nothing.
const PATIENCE: Duration = Duration::from_millis(10);

/// A process that does not outlive its owner.
#[derive(Debug)]
pub(super) struct Running(pub(super) Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs a program to its end and returns what it printed, which must fit into a pipe. `started` is
/// told its process id.
pub(super) fn output(
    bench: &Bench,
    command: Command,
    started: impl FnOnce(u32),
) -> anyhow::Result<String> {
    output_of(bench, command, None, started)
}

/// [`output`] of a program that reads a file from its standard input.
pub(super) fn output_of(
    bench: &Bench,
    mut command: Command,
    stdin: Option<File>,
    started: impl FnOnce(u32),
) -> anyhow::Result<String> {
    let program = command.get_program().display().to_string();
    let log = bench.scratch.path().join("child.log");
    let file = File::create(&log).with_context(|| log.display().to_string())?;
    let child = command
        .stdin(stdin.map_or_else(Stdio::null, Stdio::from))
        .stdout(Stdio::piped())
        .stderr(file)
        // Ctrl-C on the terminal is for this program, which ends the others.
        .process_group(0)
        .spawn()
        .map_err(|error| environment(format!("{program} does not start: {error}")))?;
    let mut running = Running(child);
    started(running.0.id());
    let status = loop {
        bench.go_on()?;
        if let Some(status) = running.0.try_wait().context("a child cannot be waited for")? {
            break status;
        }
        std::thread::sleep(PATIENCE);
    };
    if !status.success() {
        let message = format!("{program} failed ({status}):\n{}", log_tail(&log, 5));
        return Err(ExitError::new(child_exit_code(status), message).into());
    }
    let mut text = String::new();
    if let Some(mut stdout) = running.0.stdout.take() {
        stdout.read_to_string(&mut text).context("a child's output cannot be read")?;
    }
    Ok(text)
}

pub(super) fn environment(message: String) -> ExitError {
    ExitError::new(ExitCode::Environment, message)
}
