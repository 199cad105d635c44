//! Accepts connections and serves each until it ends, its client is too slow, or the service stops.

use std::io::ErrorKind;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, oneshot};
use tokio::task::JoinSet;

use super::context::Shared;
use super::limits::Limits;
use super::pace::PacedWrites;

/// How long to wait when the system has no descriptor left for a connection.
const EXHAUSTED: Duration = Duration::from_millis(100);

/// Serves until `stop` is rung or dropped, then gives what is under way a bounded time.
pub(super) async fn serve(
    listener: TcpListener,
    router: Router,
    context: Shared,
    mut stop: oneshot::Receiver<()>,
) {
    let graceful = GracefulShutdown::new();
    let places = Arc::new(Semaphore::new(context.limits.connections));
    let mut connections = JoinSet::new();
    loop {
        // A place first: without one, clients wait in the system's queue and cost nothing here.
        let accepted = async {
            let place = Arc::clone(&places).acquire_owned().await;
            (place, listener.accept().await)
        };
        let (place, accepted) = tokio::select! {
            accepted = accepted => accepted,
            Some(_) = connections.join_next() => continue,
            _ = &mut stop => break,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "a connection was not accepted");
                // The client's own doing costs no pause; want of descriptors does.
                if !matches!(
                    error.kind(),
                    ErrorKind::ConnectionAborted | ErrorKind::ConnectionReset
                ) {
                    tokio::time::sleep(EXHAUSTED).await;
                }
                continue;
            }
        };
        let connection = graceful.watch(connection(stream, router.clone(), &context.limits));
        let open = context.requests.connection();
        connections.spawn(async move {
            let _held = (place, open);
            if let Err(error) = connection.await {
                tracing::debug!(%error, "a connection ended early");
            }
        });
    }
    drop(listener);
    if tokio::time::timeout(context.limits.stop_time, graceful.shutdown()).await.is_err() {
        tracing::debug!("requests under way are cut off");
    }
    connections.shutdown().await;
}

type Io = TokioIo<PacedWrites<TcpStream>>;

fn connection(
    stream: TcpStream,
    router: Router,
    limits: &Limits,
) -> http1::Connection<Io, TowerToHyperService<Router>> {
    // Answers are small or written in large pieces; waiting to fill a packet only adds latency.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "a connection keeps its delay");
    }
    http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.head_time)
        .max_header_size(Limits::HEAD_BYTES)
        .max_buf_size(Limits::BUFFER_BYTES)
        .max_headers(Limits::HEAD_FIELDS)
        .serve_connection(
            TokioIo::new(PacedWrites::new(stream, limits)),
            TowerToHyperService::new(router),
        )
}
