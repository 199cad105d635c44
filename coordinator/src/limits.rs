//! Limits that the shell sets and that a process runs into only later, by a signal.
//!
//! A stack that is too small ends a process by SIGSEGV somewhere in the middle, a file that is too
//! large by SIGXFSZ. So the first is raised when a program starts, or refused; the second becomes an
//! error of the write, which is reported as what it is, and so is a page of shared memory that cannot be had. Stacks of threads are as large as `RUST_MIN_STACK`
//! says, which cannot be taken back in a process that has it.

use std::ffi::OsStr;

use proto::{ExitCode, ExitError, mib};
use run::bus_error;
use rustix::process::{Resource, Rlimit, Signal, getrlimit, setrlimit};
use tokio::signal::unix::{SignalKind, signal};

/// The stack that Linux gives by default, and that children get where less was allowed.
const STACK: u64 = 8 << 20;
/// The least that a program starts with: what Rust gives a thread, chosen, not measured.
const LEAST_STACK: u64 = 2 << 20;
/// The variable that says how large the stacks of threads are (bytes), in every Rust program.
const THREAD_STACK: &str = "RUST_MIN_STACK";
/// What a write fails with that would make a file larger than allowed (EFBIG).
const TOO_LARGE: i32 = rustix::io::Errno::FBIG.raw_os_error();

/// Raises what can be raised, and refuses what is too little. The first thing in a program: also
/// the reading of a command line needs a stack.
pub fn prepare() -> Result<(), ExitError> {
    raise_stack()?;
    check_thread_stack(std::env::var_os(THREAD_STACK).as_deref())?;
    let fail = |error: std::io::Error| {
        ExitError::new(ExitCode::Environment, format!("signals cannot be caught: {error}"))
    };
    // Whoever listens to a signal does not die of it. Listening outlasts the runtime. It also ends that a
    // shell had a signal ignored: who ignores the death of children never hears how they ended.
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_io().build().map_err(fail)?;
    let _context = runtime.enter();
    for kind in [SignalKind::from_raw(Signal::XFSZ.as_raw()), SignalKind::child()] {
        drop(signal(kind).map_err(fail)?);
    }
    bus_error::report().map_err(fail)
}

fn raise_stack() -> Result<(), ExitError> {
    let limit = getrlimit(Resource::Stack);
    if limit.current.is_none_or(|current| current >= STACK) {
        return Ok(());
    }
    let set = |maximum: Option<u64>| {
        let current = Some(maximum.unwrap_or(STACK).min(STACK));
        setrlimit(Resource::Stack, Rlimit { current, maximum }).is_ok()
    };
    // Root may raise the hard limit, too, everybody the other up to it.
    let _ = set(limit.maximum.map(|hard| hard.max(STACK))) || set(limit.maximum);
    let now = getrlimit(Resource::Stack).current.unwrap_or(STACK);
    if now >= LEAST_STACK {
        return Ok(());
    }
    let message = format!(
        "a program's stack may have {} here, and {} are needed; `ulimit -s {}`",
        mib(now),
        mib(LEAST_STACK),
        STACK >> 10
    );
    Err(ExitError::new(ExitCode::Environment, message))
}

/// Refuses a size that threads do not live with, or cannot have. What is no number has no effect.
fn check_thread_stack(set: Option<&OsStr>) -> Result<(), ExitError> {
    let Some(size) = set.and_then(OsStr::to_str).and_then(|size| size.parse::<usize>().ok()) else {
        return Ok(());
    };
    let reason = if (size as u64) < LEAST_STACK {
        format!("threads need {}", mib(LEAST_STACK))
    } else {
        let thread = std::thread::Builder::new().stack_size(size).spawn(|| ());
        let ended = thread.map(std::thread::JoinHandle::join);
        let Err(error) = ended else { return Ok(()) };
        format!("no thread can have as much: {error}")
    };
    let message = format!("{THREAD_STACK}={size}: {reason}; `unset {THREAD_STACK}`");
    Err(ExitError::new(ExitCode::Environment, message))
}

/// What to do about an error whose text is `error`, if it is that a file would have become larger than
/// this process may make one.
pub fn cure(error: &str) -> Option<String> {
    let limit = getrlimit(Resource::Fsize).current?;
    error.contains(&format!("(os error {TOO_LARGE})")).then(|| {
        format!("a file may have {} here; `ulimit -f unlimited`, and do the same again", mib(limit))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stacks_of_threads_that_are_too_small_or_cannot_be_are_refused() {
        let check = |size: &str| check_thread_stack(Some(OsStr::new(size)));
        for size in ["0", "1", "2097151", "9000000000000000000"] {
            let error = check(size).expect_err(size);
            assert_eq!(error.code, ExitCode::Environment);
            let said = error.to_string();
            let cure = "`unset RUST_MIN_STACK`";
            assert!(said.starts_with("RUST_MIN_STACK=") && said.ends_with(cure), "{said}");
        }
        for size in ["2097152", "8388608", "much", "-1", ""] {
            check(size).expect(size);
        }
        check_thread_stack(None).expect("the default");
    }
}
