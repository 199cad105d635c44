//! Children that signals to a whole group do not reach.
//!
//! Who ends a service or a batch job sends SIGTERM to all its processes, a person SIGINT to all of a
//! terminal's, and a terminal that is closed SIGHUP. All of them are for the coordinator, who lets the
//! iteration end, commits a checkpoint and only then sends the others home: a learner that ended by
//! itself would take the iterations since the last checkpoint with it, and the janitor outlives
//! everybody. So they start with these signals blocked: the mask is inherited, also by their threads,
//! and holds from their first instruction on. SIGKILL, also as the parent-death signal, cannot be
//! blocked.

use std::io;
use std::process::{Child, Command};

use nix::sys::signal::{SigSet, SigmaskHow, Signal};

/// Starts a child that SIGTERM, SIGINT and SIGHUP do not reach.
pub fn spawn(command: &mut Command) -> io::Result<Child> {
    let group = SigSet::from_iter([Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP]);
    // Of this thread alone, for a moment: other threads hear what comes meanwhile.
    let before = group.thread_swap_mask(SigmaskHow::SIG_BLOCK)?;
    let child = command.spawn();
    before.thread_set_mask()?;
    child
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt as _;
    use std::time::Duration;

    use rustix::process::{Pid, Signal, kill_process};

    use super::*;

    #[test]
    fn only_sigkill_ends_a_shielded_child() {
        let mut child = spawn(Command::new("sleep").arg("60")).expect("sleep starts");
        let pid = Pid::from_raw(child.id().cast_signed()).expect("a process");
        for signal in [Signal::TERM, Signal::INT, Signal::HUP] {
            kill_process(pid, signal).expect("own child");
        }
        std::thread::sleep(Duration::from_millis(100));
        assert!(child.try_wait().expect("own child").is_none(), "it was reached");
        kill_process(pid, Signal::KILL).expect("own child");
        assert_eq!(child.wait().expect("own child").signal(), Some(Signal::KILL.as_raw()));
    }

    #[test]
    fn the_mask_of_the_parent_is_as_it_was() {
        let before = SigSet::thread_get_mask().expect("readable");
        spawn(&mut Command::new("true")).expect("true starts").wait().expect("own child");
        assert_eq!(SigSet::thread_get_mask().expect("readable"), before);
    }
}
