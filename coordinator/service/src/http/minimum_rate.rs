//! Cuts clients off that trickle: a deadline for progress, not for the whole.
//!
//! The timeouts of `tower-http` and `tokio-io-timeout` begin anew with every byte, so a client that moves one a minute
//! would keep its place for ever. A client here has to move many within a time.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Sleep;

use super::limits::Limits;

/// How long a client has made us wait since it last moved enough bytes. Time that we take
/// ourselves, say for the disk, does not count.
#[derive(Debug)]
pub(super) struct MinimumRate {
    time: Duration,
    bytes: u64,
    waited: Duration,
    moved: u64,
    waiting: Option<(Instant, Pin<Box<Sleep>>)>,
}

impl MinimumRate {
    pub(super) fn new(limits: &Limits) -> Self {
        Self {
            time: limits.pace_time,
            bytes: limits.pace_bytes,
            waited: Duration::ZERO,
            moved: 0,
            waiting: None,
        }
    }

    /// Judges one poll, which moved `n` bytes or is pending: passes it on, or is ready with an
    /// error once the client has been waited for too long.
    pub(super) fn judge(
        &mut self,
        context: &mut Context<'_>,
        moved: Poll<u64>,
    ) -> Poll<io::Result<()>> {
        if let Poll::Ready(bytes) = moved {
            if let Some((since, _)) = self.waiting.take() {
                self.waited += since.elapsed();
            }
            self.moved += bytes;
            if self.moved >= self.bytes {
                self.moved = 0;
                self.waited = Duration::ZERO;
            }
            return Poll::Ready(Ok(()));
        }
        let left = self.time.saturating_sub(self.waited);
        let (_, sleep) = self
            .waiting
            .get_or_insert_with(|| (Instant::now(), Box::pin(tokio::time::sleep(left))));
        ready!(sleep.as_mut().poll(context));
        let message = format!("fewer than {} bytes in {} s", self.bytes, self.time.as_secs_f64());
        Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, message)))
    }
}

/// A connection whose writes have a pace: a client that does not read its answer is cut off.
/// Reads are left alone, because hyper also reads to notice that a waiting client has gone.
#[derive(Debug)]
pub(super) struct PacedWrites<C> {
    connection: C,
    pace: MinimumRate,
}

impl<C> PacedWrites<C> {
    pub(super) fn new(connection: C, limits: &Limits) -> Self {
        Self { connection, pace: MinimumRate::new(limits) }
    }

    fn judge<T>(
        &mut self,
        context: &mut Context<'_>,
        result: Poll<io::Result<T>>,
        bytes: impl FnOnce(&T) -> u64,
    ) -> Poll<io::Result<T>> {
        let moved = match &result {
            Poll::Ready(Ok(value)) => Poll::Ready(bytes(value)),
            Poll::Ready(Err(_)) => return result,
            Poll::Pending => Poll::Pending,
        };
        match self.pace.judge(context, moved) {
            Poll::Ready(Err(late)) => Poll::Ready(Err(late)),
            _ => result,
        }
    }
}

impl<C: AsyncRead + Unpin> AsyncRead for PacedWrites<C> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.connection).poll_read(context, buffer)
    }
}

impl<C: AsyncWrite + Unpin> AsyncWrite for PacedWrites<C> {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &[u8],
    ) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let result = Pin::new(&mut this.connection).poll_write(context, buffer);
        this.judge(context, result, |&bytes| bytes as u64)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffers: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let result = Pin::new(&mut this.connection).poll_write_vectored(context, buffers);
        this.judge(context, result, |&bytes| bytes as u64)
    }

    fn is_write_vectored(&self) -> bool {
        self.connection.is_write_vectored()
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let result = Pin::new(&mut this.connection).poll_flush(context);
        this.judge(context, result, |()| 0)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let result = Pin::new(&mut this.connection).poll_shutdown(context);
        this.judge(context, result, |()| 0)
    }
}
