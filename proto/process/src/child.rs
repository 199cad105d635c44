//! What every child process of a coordinator does first.

use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use proto::{ExitCode, ExitError};

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

/// Fixes this process to one of the processors that it may use, counted round and round.
pub fn pin(index: usize) -> Result<(), ExitError> {
    let fail = |error: rustix::io::Errno| {
        let message = format!("cannot fix this process to a processor: {error}; leave --pin out");
        ExitError::new(ExitCode::Environment, message)
    };
    let processors = processors()?;
    let mut chosen = CpuSet::new();
    chosen.set(processors[index % processors.len().max(1)]);
    sched_setaffinity(None, &chosen).map_err(fail)
}

/// Processors that this thread may use.
pub fn processors() -> Result<Vec<usize>, ExitError> {
    let allowed = sched_getaffinity(None).map_err(|error| {
        let message = format!("cannot find out which processors there are: {error}");
        ExitError::new(ExitCode::Environment, message)
    })?;
    Ok((0..CpuSet::MAX_CPU).filter(|&cpu| allowed.is_set(cpu)).collect())
}

/// Does something with this thread on `processors` alone. Threads and children that it starts meanwhile stay there.
pub fn on_processors<T>(processors: &[usize], act: impl FnOnce() -> T) -> Result<T, ExitError> {
    let fail = |error: rustix::io::Errno| {
        let message = format!("cannot keep to processors {processors:?}: {error}");
        ExitError::new(ExitCode::Environment, message)
    };
    let before = sched_getaffinity(None).map_err(fail)?;
    let mut chosen = CpuSet::new();
    for processor in processors {
        chosen.set(*processor);
    }
    sched_setaffinity(None, &chosen).map_err(fail)?;
    let done = act();
    sched_setaffinity(None, &before).map_err(fail)?;
    Ok(done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pinned_thread_has_one_processor() {
        // Affinity is a thread's own; the others of the test program keep theirs.
        std::thread::spawn(|| {
            let before = sched_getaffinity(None).expect("readable").count();
            pin(before as usize + 1).expect("pins");
            assert_eq!(sched_getaffinity(None).expect("readable").count(), 1);
        })
        .join()
        .expect("no panic");
    }

    #[test]
    fn what_is_started_on_some_processors_stays_there_and_who_starts_it_does_not() {
        std::thread::spawn(|| {
            let before = processors().expect("readable");
            let own = before[before.len() - 1];
            let there = on_processors(&[own], || std::thread::spawn(processors));
            let there = there.expect("allowed").join().expect("no panic").expect("readable");
            assert_eq!(there, [own]);
            assert_eq!(processors().expect("readable"), before);
        })
        .join()
        .expect("no panic");
    }
}
