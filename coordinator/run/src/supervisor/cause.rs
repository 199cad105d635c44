//! Why a process is no more.

use std::io::{Read as _, Seek as _, SeekFrom};
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::ExitStatus;

use proto::ExitCode;
use rustix::process::Signal;
use store::regular_files;

use crate::preflight;

/// Why a process is no more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// It ended by itself: an exit code, or a signal that a program earns, such as SIGSEGV.
    Crash(ExitStatus),
    /// SIGBUS where shared memory is full: it touched a page that there was no room for.
    SharedMemoryFull,
    /// It was silent for too long and was killed for it.
    Hang,
    /// Somebody outside sent a signal: SIGKILL, also from the kernel when memory is short, SIGTERM,
    /// SIGINT or SIGHUP. Says nothing about what the process was doing.
    Killed(ExitStatus),
}

impl Cause {
    pub(super) fn of(status: ExitStatus, hung: bool) -> Self {
        const SIGNALS: [Signal; 4] = [Signal::KILL, Signal::TERM, Signal::INT, Signal::HUP];
        let sent = |number| SIGNALS.iter().any(|signal| signal.as_raw() == number);
        match status.signal() {
            _ if hung => Self::Hang,
            Some(number)
                if number == Signal::BUS.as_raw() && preflight::shared_memory_is_full() =>
            {
                Self::SharedMemoryFull
            }
            Some(number) if sent(number) => Self::Killed(status),
            _ => Self::Crash(status),
        }
    }

    /// What the coordinator ends with if this ends the run: what the child [`child_exit_code`], or that it failed.
    pub fn exit_code(self) -> ExitCode {
        match self {
            Self::Crash(status) => child_exit_code(status),
            Self::SharedMemoryFull => ExitCode::Environment,
            Self::Hang | Self::Killed(_) => ExitCode::Child,
        }
    }

    /// Whether it says something about the block at hand: not who was killed from outside, nor who died
    /// for want of something that the machine lacks.
    pub fn blames_its_work(self) -> bool {
        !matches!(self, Self::Killed(_)) && self.exit_code() == ExitCode::Child
    }
}

/// What a child said with its exit code, where that is about the machine or the files; else that a
/// child failed.
pub fn child_exit_code(status: ExitStatus) -> ExitCode {
    [ExitCode::BadInput, ExitCode::Environment, ExitCode::RunDirectory]
        .into_iter()
        .find(|code| status.code() == Some(*code as i32))
        .unwrap_or(ExitCode::Child)
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hang => write!(f, "hung"),
            Self::SharedMemoryFull => write!(
                f,
                "signal {}: shared memory is full; {}",
                Signal::BUS.as_raw(),
                preflight::MAKE_ROOM
            ),
            Self::Crash(status) | Self::Killed(status) => match (status.code(), status.signal()) {
                (Some(code), _) => write!(f, "exit code {code}"),
                (None, Some(signal)) => write!(f, "signal {signal}"),
                (None, None) => write!(f, "unknown cause"),
            },
        }
    }
}

/// How much of the end of a log is read (bytes).
const LOG_END: u64 = 64 * 1024;

/// The last lines of a child's log, to be shown with its death; why there are none if it cannot be read.
pub fn log_tail(path: &Path, lines: usize) -> String {
    log_tail_from(path, 0, lines)
}

/// The same of what was written behind the first `from` bytes.
pub fn log_tail_from(path: &Path, from: u64, lines: usize) -> String {
    let text = match log_end(path, from) {
        Ok(text) => text,
        Err(error) => return format!("{}: cannot be read: {error}", path.display()),
    };
    let tail: Vec<_> = text.lines().rev().take(lines).collect();
    tail.into_iter().rev().collect::<Vec<_>>().join("\n")
}

fn log_end(path: &Path, from: u64) -> std::io::Result<String> {
    let mut file = regular_files::open(path)?;
    let length = file.metadata()?.len();
    let begin = from.max(length.saturating_sub(LOG_END));
    file.seek(SeekFrom::Start(begin))?;
    let text =
        String::from_utf8_lossy(&regular_files::drain(file.take(LOG_END), LOG_END)?).into_owned();
    // Of a line that begins before, the end says nothing.
    let cut = if begin > from { text.find('\n').map_or(0, |end| end + 1) } else { 0 };
    Ok(text[cut..].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_log_is_shown_however_long_it_is() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("learner.log");
        assert!(log_tail(&path, 5).contains("learner.log: cannot be read"));
        std::fs::write(&path, "one\ntwo\nthree\n").expect("writable");
        assert_eq!(log_tail(&path, 2), "two\nthree");
        assert_eq!(log_tail_from(&path, 8, 2), "three");
        assert_eq!(log_tail_from(&path, 14, 2), "");
        let long = "0123456789\n".repeat(10_000);
        std::fs::write(&path, &long).expect("writable");
        let shown = log_tail(&path, usize::MAX);
        assert!(shown.lines().all(|line| line == "0123456789"), "whole lines");
        assert_eq!(shown.lines().count() as u64, LOG_END / 11);
    }
}
