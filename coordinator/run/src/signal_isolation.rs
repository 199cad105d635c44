//! Children that signals to a whole group do not reach.
//!
//! Who ends a service or a batch job sends SIGTERM to all its processes, a person SIGINT to all of a
//! terminal's, and a terminal that is closed SIGHUP. All of them are for the coordinator, who lets the
//! iteration end, commits a checkpoint and only then sends the others home: a learner that ended by
//! itself would take the iterations since the last checkpoint with it, and the janitor outlives
//! everybody. So they start with these signals blocked: the mask is inherited, also by their threads,
//! and holds from their first instruction on. SIGKILL, also as the parent-death signal, cannot be
//! blocked.
//!
//! A file that becomes larger than `ulimit -f` allows, a log for example, would end them by SIGXFSZ. That
//! is blocked, too: the write fails instead, and whoever writes says so or does without.

use std::io;
use std::process::{Child, Command};

use nix::sys::signal::{SigSet, SigmaskHow, Signal};

/// What a child does not hear of.
const GROUP: [Signal; 4] = [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP, Signal::SIGXFSZ];

/// Starts a child that SIGTERM, SIGINT, SIGHUP and SIGXFSZ do not reach.
pub fn spawn(command: &mut Command) -> io::Result<Child> {
    spawn_without(&GROUP, command)
}

/// The same, but SIGINT reaches it: a program that has children of its own to stop in order, and counts how often it is
/// asked to. Its parent passes on what it hears itself, and a SIGTERM for all processes would be a second request.
pub fn spawn_interruptible(command: &mut Command) -> io::Result<Child> {
    let others: Vec<Signal> =
        GROUP.into_iter().filter(|signal| *signal != Signal::SIGINT).collect();
    spawn_without(&others, command)
}

fn spawn_without(signals: &[Signal], command: &mut Command) -> io::Result<Child> {
    let group: SigSet = signals.iter().copied().collect();
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
    fn sigint_alone_reaches_a_child_that_may_be_interrupted() {
        // A shell that starts the tests in the background has them ignore SIGINT, and so would the child.
        let mut command = Command::new("env");
        command.args(["--default-signal=INT", "sleep", "60"]);
        let mut child = spawn_interruptible(&mut command).expect("env starts");
        let pid = Pid::from_raw(child.id().cast_signed()).expect("a process");
        for signal in [Signal::TERM, Signal::HUP] {
            kill_process(pid, signal).expect("own child");
        }
        std::thread::sleep(Duration::from_millis(100));
        assert!(child.try_wait().expect("own child").is_none(), "it was reached");
        kill_process(pid, Signal::INT).expect("own child");
        assert_eq!(child.wait().expect("own child").signal(), Some(Signal::INT.as_raw()));
    }

    #[test]
    fn a_file_that_may_not_become_so_large_is_an_error_and_no_end() {
        let dir = tempfile::tempdir().expect("tempdir");
        let file = dir.path().join("log");
        let mut command = Command::new("bash");
        command.args(["-c", "ulimit -f 1 && dd if=/dev/zero of=\"$0\" bs=1k count=4"]).arg(&file);
        command.env("LC_ALL", "C").stderr(std::process::Stdio::piped());
        let child = spawn(&mut command).expect("bash starts");
        let output = child.wait_with_output().expect("own child");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{:?}: {said}", output.status);
        assert!(said.contains("File too large"), "{said}");
        assert_eq!(file.metadata().expect("there").len(), 1024);
    }

    #[test]
    fn the_mask_of_the_parent_is_as_it_was() {
        let before = SigSet::thread_get_mask().expect("readable");
        spawn(&mut Command::new("true")).expect("true starts").wait().expect("own child");
        assert_eq!(SigSet::thread_get_mask().expect("readable"), before);
    }
}
