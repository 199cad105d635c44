//! The ends of the channel that carries snapshots, piece by piece.

use iceoryx2::port::SendError;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::sample::Sample;
use proto::layout::SnapshotHeader;

use crate::bells::Bell;
use crate::error::{check_connections, transfer_error};
use crate::header::Shared;
use crate::transport::Private as Ipc;
use crate::{ChannelError, PIECE_LEN};

/// Sends a snapshot, piece by piece.
#[derive(Debug)]
pub struct PieceSender {
    pub(crate) publisher: Publisher<Ipc, [u8], Shared<SnapshotHeader>>,
    pub(crate) bell: Bell,
}

impl PieceSender {
    /// Sends the piece of `snapshot` that begins at `header.offset`, at most [`PIECE_LEN`] bytes.
    /// Returns the offset of the next one; the same offset if the receiver's queue stayed full.
    pub fn send(&self, header: SnapshotHeader, snapshot: &[u8]) -> Result<u64, ChannelError> {
        let begin = header.offset as usize;
        let piece = &snapshot[begin..snapshot.len().min(begin + PIECE_LEN)];
        let mut sample = self
            .publisher
            .loan_slice_uninit(piece.len())
            .map_err(|error| transfer_error("snapshot", "loan", &error))?
            .write_from_slice(piece);
        sample.user_header_mut().0 = SnapshotHeader { total: snapshot.len() as u64, ..header };
        // Rung first: a full queue is emptied by a receiver who is awake.
        self.bell.ring();
        match sample.send() {
            Ok(_) => {}
            Err(SendError::UnableToDeliver) => return Ok(header.offset),
            Err(error) => return Err(transfer_error("snapshot", "send", &error)),
        }
        self.bell.ring();
        check_connections("snapshot")?;
        Ok((begin + piece.len()) as u64)
    }
}

/// Receives the pieces of snapshots.
#[derive(Debug)]
pub struct PieceReceiver(pub(crate) Subscriber<Ipc, [u8], Shared<SnapshotHeader>>);

impl PieceReceiver {
    /// The next piece, if one is there.
    pub fn try_receive(&self) -> Result<Option<PieceSample>, ChannelError> {
        let sample = self.0.receive().map_err(|e| transfer_error("snapshot", "receive", &e))?;
        check_connections("snapshot")?;
        Ok(sample.map(PieceSample))
    }
}

/// A piece of a snapshot in shared memory.
#[derive(Debug)]
pub struct PieceSample(Sample<Ipc, [u8], Shared<SnapshotHeader>>);

impl PieceSample {
    /// The bytes.
    pub fn payload(&self) -> &[u8] {
        self.0.payload()
    }

    /// Where they belong.
    pub fn header(&self) -> &SnapshotHeader {
        &self.0.user_header().0
    }
}
