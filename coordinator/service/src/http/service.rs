//! The service as its owner sees it: started, addressed, stopped.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use proto::{ExitCode, ExitError};
use store::checkpoint::CheckpointStore;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::oneshot;

use super::context::Context;
use super::limits::Limits;
use super::run_directory::Runs;
use super::token::Token;
use super::{access, connections, router};
use crate::live::LiveRun;

/// Threads that may wait for the disk at a time.
const POOL: usize = 64;
/// How long work on the disk may still take when the service stops.
const DISK_TIME: Duration = Duration::from_secs(2);

/// What a service needs.
#[derive(Debug)]
pub struct ServiceSpec {
    /// Where to listen; port 0 takes a free one.
    pub address: SocketAddr,
    /// What clients must show,
    pub own: Token,
    /// or this, which its owner has chosen; needed unless the address is loopback.
    pub token: Option<Token>,
    /// The checkpoints to serve.
    pub store: CheckpointStore,
    /// The run beside which this stands.
    pub live: Option<LiveRun>,
    /// A directory of runs, which are served instead of the checkpoints, for looking only.
    pub runs: Option<PathBuf>,
    /// Bounds.
    pub limits: Limits,
    /// Whether to change nothing, whoever asks.
    pub read_only: bool,
}

impl ServiceSpec {
    /// A service of `store` on a free port of loopback, beside no run.
    pub fn new(store: CheckpointStore, own: Token) -> Self {
        Self {
            address: SocketAddr::from(([127, 0, 0, 1], 0)),
            own,
            token: None,
            store,
            live: None,
            runs: None,
            limits: Limits::default(),
            read_only: false,
        }
    }
}

/// A service that runs. Dropping it stops it.
#[derive(Debug)]
pub struct Service {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Service {
    /// Starts to listen and to serve, on a thread of its own.
    pub fn start(spec: ServiceSpec) -> Result<Self, ExitError> {
        access::check_address(spec.address, spec.token.as_ref())?;
        let failure = |what: &str, error: &std::io::Error| {
            ExitError::new(ExitCode::Environment, format!("the HTTP service {what}: {error}"))
        };
        let runtime = Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(POOL)
            .thread_name("http-disk")
            .build()
            .map_err(|error| failure("has no runtime", &error))?;
        // Bound before this function returns, so that the address is known and errors are heard.
        let listen = format!(
            "cannot listen on {}; another --listen address or port 0 may be free",
            spec.address
        );
        let listener = runtime
            .block_on(tokio::net::TcpListener::bind(spec.address))
            .map_err(|error| failure(&listen, &error))?;
        let address = listener.local_addr().map_err(|error| failure(&listen, &error))?;
        let (stop, stopped) = oneshot::channel();
        let tokens = spec.token.into_iter().chain([spec.own]).collect();
        let read_only = spec.read_only || spec.runs.is_some();
        let context = Context::new(spec.store, spec.live, tokens, spec.limits, read_only);
        let context = Arc::new(context.of_runs(spec.runs.map(Runs::new)));
        let thread = std::thread::Builder::new()
            .name("http".to_owned())
            .spawn(move || run(runtime, listener, context, stopped))
            .map_err(|error| failure("has no thread", &error))?;
        tracing::debug!(%address, "the HTTP service listens");
        Ok(Self { address, stop: Some(stop), thread: Some(thread) })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether it still serves; it does until it is stopped, unless its thread has failed.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// Stops listening, gives requests under way a moment, and returns when all is closed.
    pub fn stop(mut self) {
        self.shut_down();
    }

    fn shut_down(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the HTTP service's thread had panicked");
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.shut_down();
    }
}

fn run(
    runtime: Runtime,
    listener: tokio::net::TcpListener,
    context: Arc<Context>,
    stopped: oneshot::Receiver<()>,
) {
    let router = router::router(Arc::clone(&context));
    runtime.block_on(connections::serve(listener, router, context, stopped));
    runtime.shutdown_timeout(DISK_TIME);
}
