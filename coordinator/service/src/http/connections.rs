//! Accepts connections and serves each until it ends, its client is too slow, another one needs its
//! place, or the service stops.

use std::convert::Infallible;
use std::io::ErrorKind;
use std::time::Duration;

use axum::Router;
use axum::response::Response;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::Service;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::task::JoinSet;

use super::connection_slots::{ConnectionSlot, ConnectionSlots};
use super::context::Shared;
use super::limits::Limits;
use super::minimum_rate::PacedWrites;

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
    let seats = ConnectionSlots::new(&context.limits);
    let mut connections = JoinSet::new();
    loop {
        // Only who is there needs a place. Meanwhile others wait in the system's queue, where they
        // cost nothing here.
        let accepted = async {
            let (stream, _) = listener.accept().await?;
            Ok::<_, std::io::Error>((stream, seats.take().await))
        };
        let accepted = tokio::select! {
            accepted = accepted => accepted,
            _ = &mut stop => break,
        };
        while connections.try_join_next().is_some() {}
        let (stream, held) = match accepted {
            Ok(accepted) => accepted,
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
        let served =
            Seated { router: TowerToHyperService::new(router.clone()), seat: held.seat().clone() };
        let connection = graceful.watch(connection(stream, served, &context.limits));
        let open = context.requests.connection();
        connections.spawn(async move {
            let _open = open;
            tokio::select! {
                ended = connection => {
                    if let Err(error) = ended {
                        tracing::debug!(%error, "a connection ended early");
                    }
                }
                () = held.seat().called_for() => {
                    tracing::debug!("a connection was ended: others waited for its place");
                }
            }
        });
    }
    drop(listener);
    context.stopping.send_replace(true);
    if tokio::time::timeout(context.limits.stop_time, graceful.shutdown()).await.is_err() {
        tracing::debug!("requests under way are cut off");
    }
    connections.shutdown().await;
}

/// The routes, for the client who has this place.
#[derive(Debug)]
struct Seated {
    router: TowerToHyperService<Router>,
    seat: ConnectionSlot,
}

type Request = hyper::Request<Incoming>;

impl Service<Request> for Seated {
    type Response = Response;
    type Error = Infallible;
    type Future = <TowerToHyperService<Router> as Service<Request>>::Future;

    fn call(&self, mut request: Request) -> Self::Future {
        request.extensions_mut().insert(self.seat.clone());
        self.router.call(request)
    }
}

type Io = TokioIo<PacedWrites<TcpStream>>;

fn connection(stream: TcpStream, served: Seated, limits: &Limits) -> http1::Connection<Io, Seated> {
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
        .serve_connection(TokioIo::new(PacedWrites::new(stream, limits)), served)
}
