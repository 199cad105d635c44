//! Ctrl-C and friends, counted.
//!
//! SIGINT, SIGTERM and SIGHUP, the last of them from a terminal that is closed, ask for the same. The
//! first one lets what is under way come to its end, the second one ends it at once. Whoever was told to
//! ignore SIGHUP, as `nohup` does, goes on ignoring it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use proto::ExitCode;
use rustix::process::Signal;
use tokio::signal::unix::{SignalKind, signal};

/// How long a process may take to end by itself after the second request.
const GRACE: Duration = Duration::from_secs(3);
/// How long its last word may take.
const LAST_WORD: Duration = Duration::from_millis(200);

/// How often the user asked to stop: once means finish the iteration, twice means now.
#[derive(Debug, Clone, Default)]
pub struct StopRequests(Arc<AtomicUsize>);

impl StopRequests {
    /// Nobody asked yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts SIGINT, SIGTERM and SIGHUP from now on, on a thread of its own.
    pub fn listen(&self) -> std::io::Result<()> {
        let requests = self.clone();
        watch(move || {
            requests.ask();
        })
    }

    /// Likewise, and sees to it that the process ends when it is asked a second time, whatever its
    /// threads wait for: a lock that somebody holds, a disk that stands still. They have a moment to end
    /// in order, a third request takes that away. `message` is what the user reads then.
    pub fn listen_and_insist(&self, message: &'static str) -> std::io::Result<()> {
        let requests = self.clone();
        watch(move || match requests.ask() {
            1 => {}
            2 => {
                let last = std::thread::Builder::new().name("end".to_owned()).spawn(move || {
                    std::thread::sleep(GRACE);
                    end(message);
                });
                if last.is_err() {
                    end(message);
                }
            }
            _ => end(message),
        })
    }

    /// Asks once more; returns how often it was asked now.
    pub fn ask(&self) -> usize {
        self.0.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// How often it was asked.
    pub fn count(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}

/// Ends the process at SIGINT, SIGTERM and SIGHUP from now on, with `message`. Once anything has
/// listened to them, they no longer do so by themselves.
pub fn exit_when_asked(message: String) -> std::io::Result<()> {
    watch(move || end(&message))
}

/// Ends the process with all its threads, whatever they do. Children die with it, and the janitor
/// removes their shared memory.
#[expect(
    clippy::exit,
    reason = "a request to stop at once; whoever asks for this has nothing to undo"
)]
fn end(message: &str) -> ! {
    say(format!("error: {message}"));
    std::process::exit(ExitCode::Interrupted as i32)
}

/// Writes to standard error, but does not wait for it for long: a terminal that is held with Ctrl-S takes
/// nothing, nor does a pipe that nobody reads, and another thread may hold standard error meanwhile.
fn say(message: String) {
    let (done, wait) = mpsc::channel();
    let speaker = std::thread::Builder::new().name("last word".to_owned()).spawn(move || {
        output::note(&message);
        // Who waits may have gone.
        let _ = done.send(());
    });
    if speaker.is_ok() {
        let _ = wait.recv_timeout(LAST_WORD);
    }
}

/// Calls `act` at each SIGINT, SIGTERM and SIGHUP, on a thread of its own.
fn watch(act: impl Fn() + Send + 'static) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    // Registered before this function returns, so that no signal is missed.
    let (mut interrupt, mut terminate, mut hang_up) = {
        let _context = runtime.enter();
        let hang_up =
            if is_ignored(Signal::HUP) { None } else { Some(signal(SignalKind::hangup())?) };
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?, hang_up)
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        runtime.block_on(async {
            loop {
                let hung_up = async {
                    match &mut hang_up {
                        Some(hang_up) => hang_up.recv().await,
                        None => std::future::pending().await,
                    }
                };
                tokio::select! {
                    _ = interrupt.recv() => act(),
                    _ = terminate.recv() => act(),
                    _ = hung_up => act(),
                }
            }
        });
    })?;
    Ok(())
}

/// Whether this process ignores a signal, because whoever started it wanted that.
fn is_ignored(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignored(&status) & (1 << (signal.as_raw() - 1)) != 0
}

/// The mask of ignored signals in a process's status, see proc_pid_status(5).
fn ignored(status: &str) -> u64 {
    let line = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    line.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_says_which_signals_are_ignored() {
        // Bit n − 1 for signal n: 1 is SIGHUP, 13 SIGPIPE.
        let status = "Name:\toctopus\nSigBlk:\t0000000000000003\nSigIgn:\t0000000000001001\n";
        assert_eq!(ignored(status), (1 << 12) | 1);
        assert_eq!(ignored("Name:\toctopus\n"), 0);
        assert!(is_ignored(Signal::PIPE), "Rust's programs ignore it");
        assert!(!is_ignored(Signal::TERM));
    }
}
