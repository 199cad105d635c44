//! Ctrl-C and friends, counted.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::signal::unix::{SignalKind, signal};

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
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        let requests = self.clone();
        // Registered before this function returns, so that no signal is missed.
        let (mut interrupt, mut terminate) = {
            let _context = runtime.enter();
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
        };
        std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
            runtime.block_on(async {
                loop {
                    tokio::select! {
                        _ = interrupt.recv() => requests.ask(),
                        _ = terminate.recv() => requests.ask(),
                    }
                }
            });
        })?;
        Ok(())
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
