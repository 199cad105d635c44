//! Why a process is no more.

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

/// The last lines of a child's log, to be shown with its death.
pub fn log_tail(path: &Path, lines: usize) -> String {
    let text = regular_files::read(path, regular_files::RECORD).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let tail: Vec<_> = text.lines().rev().take(lines).collect();
    tail.into_iter().rev().collect::<Vec<_>>().join("\n")
}
