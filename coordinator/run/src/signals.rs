//! Ctrl-C and friends, counted.
//!
//! SIGINT, SIGTERM and SIGHUP, the last of them from a terminal that is closed, ask for the same. The
//! first one lets what is under way come to its end, the second one ends it at once. Whoever was told to
//! ignore SIGHUP, as `nohup` does, goes on ignoring it.
//!
//! Programs ask several times where they mean one: a batch system signals every process of a job, and scripts among them
//! pass on what they hear. So a SIGTERM or SIGHUP that comes right after another request is that one. A person
//! who presses Ctrl-C twice means it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use proto::ExitCode;
use rustix::process::Signal;
use tokio::signal::unix::{SignalKind, signal};

/// How long a process may take to end by itself after the second request.
const GRACE: Duration = Duration::from_secs(3);
/// How soon after a request a program's next one is the same.
const TOGETHER: Duration = Duration::from_millis(500);
/// How long its last word may take.
const LAST_WORD: Duration = Duration::from_millis(200);

/// Who asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum By {
    /// With Ctrl-C: SIGINT.
    Person,
    /// A program, or a terminal that is closed: SIGTERM, SIGHUP.
    Program,
}

/// Tells requests from repetitions.
#[derive(Debug, Default)]
struct Requests {
    last: Option<Instant>,
}

impl Requests {
    /// Whether who asks at this time asks for something new.
    fn is_new(&mut self, by: By, now: Instant) -> bool {
        let together = self.last.is_some_and(|last| now.duration_since(last) < TOGETHER);
        if by == By::Program && together {
            return false;
        }
        self.last = Some(now);
        true
    }
}

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
        let mut all = Requests::default();
        watch(move |by| {
            requests.count_if(all.is_new(by, Instant::now()));
        })
    }

    /// Likewise, and sees to it that the process ends when it is asked a second time, whatever its
    /// threads wait for: a lock that somebody holds, a disk that stands still. They have a moment to end
    /// in order, a third request takes that away. `message` is what the user reads then.
    pub fn listen_and_insist(&self, message: &'static str) -> std::io::Result<()> {
        let requests = self.clone();
        let mut all = Requests::default();
        watch(move |by| match requests.count_if(all.is_new(by, Instant::now())) {
            // None of its own, or the first.
            0 | 1 => {}
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

    /// Asks once more if this is a new request; returns how often it was asked now, 0 if it is none.
    fn count_if(&self, is_new: bool) -> usize {
        if is_new { self.ask() } else { 0 }
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
    watch(move |_| end(&message))
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
fn watch(mut act: impl FnMut(By) + Send + 'static) -> std::io::Result<()> {
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
                    _ = interrupt.recv() => act(By::Person),
                    _ = terminate.recv() => act(By::Program),
                    _ = hung_up => act(By::Program),
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
    fn a_program_that_asks_twice_at_once_asks_once_and_a_person_twice() {
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut all = Requests::default();
        assert!(all.is_new(By::Program, at(0)));
        assert!(!all.is_new(By::Program, at(1)));
        assert!(!all.is_new(By::Program, at(499)), "what was none does not count");
        assert!(all.is_new(By::Program, at(500)));
        assert!(all.is_new(By::Person, at(501)));
        assert!(!all.is_new(By::Program, at(502)), "a script that passes Ctrl-C on");
        assert!(all.is_new(By::Person, at(503)));
    }

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
