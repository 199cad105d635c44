//! What every child process of a coordinator does first.

use rustix::process::{Signal, getppid, set_parent_process_death_signal};

use crate::{ExitCode, ExitError};

/// Asks the kernel to kill this process when its parent dies, and makes sure that the parent, which
/// should be the process `expected`, has not died yet.
pub fn die_with_parent(expected: Option<i32>) -> Result<(), ExitError> {
    let before = getppid();
    set_parent_process_death_signal(Some(Signal::KILL)).map_err(|error| {
        let message = format!("cannot tie this process to its parent: {error}");
        ExitError::new(ExitCode::Environment, message)
    })?;
    // The parent may have died before the request took effect: then somebody else is the parent.
    let now = getppid();
    let pid = now.map_or(0, |pid| pid.as_raw_nonzero().get());
    if now != before || expected.is_some_and(|expected| expected != pid) {
        let message = "the process that started this one is gone";
        return Err(ExitError::new(ExitCode::Failure, message));
    }
    Ok(())
}
