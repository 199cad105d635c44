//! Puts the pieces of a snapshot together again.

use proto::Digest;
use proto::layout::SnapshotHeader;

/// A training state in flight, whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Snapshot {
    /// Iterations trained on.
    pub iteration: u64,
    /// Digest of the state.
    pub digest: Digest,
    /// The state as safetensors.
    pub bytes: Vec<u8>,
}

/// Collects pieces; they arrive in order, but a learner that died in the middle leaves a stump.
#[derive(Debug, Default)]
pub struct Assembly {
    header: SnapshotHeader,
    bytes: Vec<u8>,
}

impl Assembly {
    /// An empty assembly.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a piece; returns the snapshot with its last one. A piece that does not continue what
    /// is there starts anew, if it is a first piece, and is refused otherwise.
    pub fn add(
        &mut self,
        header: &SnapshotHeader,
        piece: &[u8],
    ) -> Result<Option<Snapshot>, String> {
        if header.offset == 0 {
            self.bytes.clear();
            self.header = *header;
        }
        let expected = SnapshotHeader { offset: self.bytes.len() as u64, ..self.header };
        if *header != expected {
            let reason = format!("snapshot piece {header:?} does not continue {expected:?}");
            self.bytes.clear();
            return Err(reason);
        }
        self.bytes.extend_from_slice(piece);
        if (self.bytes.len() as u64) < header.total {
            return Ok(None);
        }
        Ok(Some(Snapshot {
            iteration: header.iteration,
            digest: Digest(header.digest),
            bytes: std::mem::take(&mut self.bytes),
        }))
    }
}
