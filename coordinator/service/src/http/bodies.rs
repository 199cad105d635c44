//! Bodies of answers that are too large for memory.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt as _;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use axum::body::{self, Bytes};
use futures_util::stream;
use http_body::{Body, Frame, SizeHint};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Bytes handed to the connection at a time.
const PIECE: usize = 256 * 1024;
/// Pieces that wait for the connection.
const WAITING: usize = 2;

/// A part of a file, read piece by piece as the client takes it.
#[derive(Debug)]
pub(super) struct FileBody {
    file: Arc<File>,
    rest: Range<u64>,
    reading: Option<JoinHandle<io::Result<Vec<u8>>>>,
}

impl FileBody {
    pub(super) fn new(file: File, part: Range<u64>) -> Self {
        Self { file: Arc::new(file), rest: part, reading: None }
    }
}

impl Body for FileBody {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        if self.rest.is_empty() {
            return Poll::Ready(None);
        }
        let this = &mut *self;
        let reading = this.reading.get_or_insert_with(|| {
            let file = Arc::clone(&this.file);
            let (at, left) = (this.rest.start, this.rest.end - this.rest.start);
            let len = usize::try_from(left).map_or(PIECE, |left| left.min(PIECE));
            tokio::task::spawn_blocking(move || {
                let mut piece = vec![0; len];
                file.read_exact_at(&mut piece, at).map(|()| piece)
            })
        });
        let read = ready!(Pin::new(reading).poll(context));
        this.reading = None;
        // An error ends the connection, so that the client does not take the rest for the whole.
        let piece = read.map_err(io::Error::other).flatten();
        if let Ok(piece) = &piece {
            this.rest.start += piece.len() as u64;
        } else {
            this.rest.start = this.rest.end;
        }
        Poll::Ready(Some(piece.map(|piece| Frame::data(piece.into()))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty()
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.rest.end - self.rest.start)
    }
}

/// The body that answers a HEAD whose content has a length that is not known: an empty one would have one.
pub(super) fn unknown() -> body::Body {
    body::Body::from_stream(stream::empty::<io::Result<Bytes>>())
}

#[derive(Debug)]
enum Piece {
    Data(Bytes),
    End,
    Failed(io::Error),
}

/// A body that another thread writes; see [`pipe`].
#[derive(Debug)]
pub(super) struct PipeBody {
    pieces: mpsc::Receiver<Piece>,
    first: Option<Piece>,
    ended: bool,
}

/// The end of a pipe that is written to, by a thread that may wait.
#[derive(Debug)]
pub(super) struct PipeWriter {
    pieces: mpsc::Sender<Piece>,
    piece: Vec<u8>,
}

/// A body and its writer. Unless the writer is finished in success, the connection ends in the
/// middle of the body, and the client knows that it has not all.
pub(super) fn pipe() -> (PipeWriter, PipeBody) {
    let (sender, receiver) = mpsc::channel(WAITING);
    let writer = PipeWriter { pieces: sender, piece: Vec::with_capacity(PIECE) };
    (writer, PipeBody { pieces: receiver, first: None, ended: false })
}

impl PipeBody {
    /// Waits for the first piece: a failure before it can still be told with a status code.
    pub(super) async fn started(mut self) -> io::Result<Self> {
        match self.pieces.recv().await {
            Some(Piece::Failed(error)) => Err(error),
            Some(piece) => {
                self.first = Some(piece);
                Ok(self)
            }
            None => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the writer has gone")),
        }
    }
}

impl PipeWriter {
    /// Ends the body, well or not.
    pub(super) fn finish(mut self, result: io::Result<()>) {
        let last = match result.and_then(|()| io::Write::flush(&mut self)) {
            Ok(()) => Piece::End,
            Err(error) => Piece::Failed(error),
        };
        // A client that has gone does not care.
        let _ = self.pieces.blocking_send(last);
    }
}

impl io::Write for PipeWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = bytes.len().min(PIECE - self.piece.len());
        self.piece.extend_from_slice(&bytes[..taken]);
        if self.piece.len() == PIECE {
            self.flush()?;
        }
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.piece.is_empty() {
            return Ok(());
        }
        let piece = std::mem::replace(&mut self.piece, Vec::with_capacity(PIECE));
        self.pieces
            .blocking_send(Piece::Data(piece.into()))
            .map_err(|_| io::Error::new(io::ErrorKind::BrokenPipe, "the client has gone"))
    }
}

impl Body for PipeBody {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        if self.ended {
            return Poll::Ready(None);
        }
        let piece = match self.first.take() {
            Some(first) => Some(first),
            None => ready!(self.pieces.poll_recv(context)),
        };
        if let Some(Piece::Data(bytes)) = piece {
            return Poll::Ready(Some(Ok(Frame::data(bytes))));
        }
        self.ended = true;
        Poll::Ready(match piece {
            Some(Piece::End) => None,
            Some(Piece::Failed(error)) => Some(Err(error)),
            _ => Some(Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the writer has gone"))),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[tokio::test]
    async fn a_pipe_carries_every_byte() {
        let content: Vec<u8> = (0..3 * PIECE + 17).map(|index| (index % 251) as u8).collect();
        let (mut writer, body) = pipe();
        let copy = content.clone();
        let thread = std::thread::spawn(move || {
            let result = copy.chunks(1000).try_for_each(|chunk| writer.write_all(chunk));
            writer.finish(result);
        });
        let read = axum::body::to_bytes(axum::body::Body::new(body), usize::MAX).await;
        assert!(read.expect("whole") == content);
        thread.join().expect("ends");
    }

    #[tokio::test]
    async fn a_writer_that_dies_is_no_end() {
        let (mut writer, body) = pipe();
        let thread = std::thread::spawn(move || {
            writer.write_all(&[1; 10]).expect("room");
            drop(writer);
        });
        thread.join().expect("ends");
        let read = axum::body::to_bytes(axum::body::Body::new(body), usize::MAX).await;
        assert!(read.is_err(), "the client must not take a part for the whole");
    }

    #[tokio::test]
    async fn a_reader_that_goes_stops_the_writer() {
        let (mut writer, body) = pipe();
        let thread = std::thread::spawn(move || {
            loop {
                if let Err(error) = writer.write_all(&[0; 4096]) {
                    return error.kind();
                }
            }
        });
        drop(body);
        assert_eq!(thread.join().expect("ends"), io::ErrorKind::BrokenPipe);
    }

    #[tokio::test]
    async fn a_file_that_has_shrunk_ends_in_an_error() {
        let path = tempfile::NamedTempFile::new().expect("tempfile");
        std::fs::write(path.path(), vec![7; PIECE + 10]).expect("writes");
        let open = || File::open(path.path()).expect("opens");
        let read = async |body| axum::body::to_bytes(axum::body::Body::new(body), usize::MAX).await;
        let whole = read(FileBody::new(open(), 0..PIECE as u64 + 10)).await.expect("whole");
        assert_eq!(whole.len(), PIECE + 10);
        let part = read(FileBody::new(open(), 5..8)).await.expect("a part");
        assert_eq!(part, vec![7; 3]);
        assert!(read(FileBody::new(open(), 0..PIECE as u64 + 11)).await.is_err());
    }
}
