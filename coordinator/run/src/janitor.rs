//! Cleans up when the coordinator is killed.
//!
//! Whoever is killed with signal 9 cleans nothing up, so a small process of its own waits beside
//! every run: this program again, with the hidden command `janitor`. It holds the reading end of a
//! pipe whose writing end only the coordinator has. The coordinator writes the process ids of its
//! children into it, and `done` when it has cleaned up itself. If the pipe ends without that word,
//! the coordinator is dead: the janitor waits for the children to follow (they die with their
//! parent), kills those that do not, and removes the run's shared memory.

use std::io::{BufRead, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use channels::Domain;
use rustix::process::{Pid, Signal, kill_process};

use crate::{environment, signal_isolation};

/// How long a janitor may take to go home. One that somebody has stopped holds nobody up: it goes when it is
/// continued.
const GOODBYE: Duration = Duration::from_secs(2);

/// The coordinator's side.
#[derive(Debug)]
pub struct Janitor {
    process: Child,
    pipe: Option<ChildStdin>,
}

impl Janitor {
    /// Starts the janitor of `domain`.
    pub fn start(domain: &Domain) -> std::io::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        environment::clean(&mut command);
        command
            .args(["janitor", "--domain", domain.as_str()])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            // Ctrl-C on the terminal is not for the janitor.
            .process_group(0);
        // Nor is what ends all others.
        let mut process = signal_isolation::spawn(&mut command)?;
        let pipe = process.stdin.take();
        Ok(Self { process, pipe })
    }

    /// Tells of a child to outlast.
    pub fn watch(&mut self, pid: u32) {
        if let Some(pipe) = &mut self.pipe {
            let _ = writeln!(pipe, "{pid}");
        }
    }

    /// Sends the janitor home: everything is clean.
    pub fn dismiss(mut self) {
        if let Some(mut pipe) = self.pipe.take() {
            let _ = writeln!(pipe, "done");
        }
        let patience = Instant::now() + GOODBYE;
        while matches!(self.process.try_wait(), Ok(None)) && Instant::now() < patience {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// The janitor's side: reads `input` to its end, then cleans `domain` up if need be.
pub fn run(domain: &Domain, input: impl BufRead) -> std::io::Result<()> {
    let mut children = Vec::new();
    for line in input.lines() {
        let Ok(line) = line else { break };
        if line == "done" {
            return Ok(());
        }
        children.extend(line.parse().ok().and_then(Pid::from_raw));
    }
    let patience = Instant::now() + Duration::from_secs(2);
    while Instant::now() < patience && children.iter().any(|pid| belongs(*pid, domain)) {
        std::thread::sleep(Duration::from_millis(20));
    }
    for pid in children {
        if belongs(pid, domain) {
            let _ = kill_process(pid, Signal::KILL);
        }
    }
    std::thread::sleep(Duration::from_millis(50));
    domain.remove_leftovers().map(|_| ())
}

/// Whether the process lives and is the child that was told of: numbers are used again, and a
/// child has the domain on its command line.
fn belongs(pid: Pid, domain: &Domain) -> bool {
    std::fs::read(format!("/proc/{}/cmdline", pid.as_raw_nonzero()))
        .is_ok_and(|line| String::from_utf8_lossy(&line).contains(domain.as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// It was waited for without end, and nothing of the run was left but that.
    #[test]
    fn a_janitor_that_was_stopped_holds_nobody_up() {
        let mut process =
            Command::new("sleep").arg("60").stdin(Stdio::piped()).spawn().expect("starts");
        let (pid, pipe) = (Pid::from_child(&process), process.stdin.take());
        kill_process(pid, Signal::STOP).expect("own child");
        let begun = Instant::now();
        Janitor { process, pipe }.dismiss();
        let waited = begun.elapsed();
        kill_process(pid, Signal::KILL).expect("it is still there");
        rustix::process::waitpid(Some(pid), rustix::process::WaitOptions::empty())
            .expect("own child");
        assert!(waited >= GOODBYE, "{waited:?}");
    }
}
