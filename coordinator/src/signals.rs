//! Ctrl-C and friends, counted.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use proto::ExitCode;
use tokio::signal::unix::{SignalKind, signal};

use crate::output;

/// How often the user asked to stop: once means finish the iteration, twice means now.
#[derive(Debug, Clone, Default)]
pub struct StopRequests(Arc<AtomicUsize>);

impl StopRequests {
    /// Nobody asked yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts SIGINT and SIGTERM from now on, on a thread of its own.
    pub fn listen(&self) -> std::io::Result<()> {
        let requests = self.clone();
        watch(move || requests.ask())
    }

    /// Asks once more.
    pub fn ask(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// How often it was asked.
    pub fn count(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}

/// Ends the process at SIGINT and SIGTERM from now on, with `message`. Once anything has listened
/// to them, they no longer do so by themselves.
#[expect(
    clippy::exit,
    reason = "a request to stop at once; whoever asks for this has nothing to undo"
)]
pub fn exit_when_asked(message: String) -> std::io::Result<()> {
    watch(move || {
        output::note(&format!("error: {message}"));
        std::process::exit(ExitCode::Interrupted as i32)
    })
}

/// Calls `act` at each SIGINT and SIGTERM, on a thread of its own.
fn watch(act: impl Fn() + Send + 'static) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    // Registered before this function returns, so that no signal is missed.
    let (mut interrupt, mut terminate) = {
        let _context = runtime.enter();
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        runtime.block_on(async {
            loop {
                tokio::select! {
                    _ = interrupt.recv() => act(),
                    _ = terminate.recv() => act(),
                }
            }
        });
    })?;
    Ok(())
}
