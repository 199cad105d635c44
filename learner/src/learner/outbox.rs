//! Snapshots that wait to be sent: the one on its way, and the newest other one.
//!
//! A coordinator that stands still takes nothing, and a state may take longer to send than iterations take to
//! train. Then what lies between is given up, as it is where a disk is slower than the training: a snapshot
//! that is committed later serves whoever asked for an earlier one.

use proto::layout::SnapshotHeader;

/// Pieces that are sent in one go, as many as the channel holds: blocks that arrive wait meanwhile.
const PIECES: usize = 4;

/// Snapshots on their way.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    sending: Option<Outgoing>,
    /// The newest, if that is another one.
    waiting: Option<Outgoing>,
    /// Memory of a snapshot that has been sent, for the next one.
    spare: Vec<u8>,
}

/// A snapshot of which the pieces before `header.offset` have been sent.
#[derive(Debug)]
struct Outgoing {
    header: SnapshotHeader,
    bytes: Vec<u8>,
}

impl Outbox {
    /// An empty one, with memory for the first snapshot.
    pub(super) fn new(spare: Vec<u8>) -> Self {
        Self { spare, ..Self::default() }
    }

    /// Whether there is nothing to send.
    pub(super) fn is_empty(&self) -> bool {
        self.sending.is_none()
    }

    /// Puts in a snapshot, which `write` copies into memory that is used again. One of that iteration that is on
    /// its way already is the same.
    pub(super) fn put(&mut self, header: SnapshotHeader, write: impl FnOnce(&mut Vec<u8>)) {
        let newest = self.waiting.as_ref().or(self.sending.as_ref());
        if newest.is_some_and(|newest| newest.header.iteration == header.iteration) {
            return;
        }
        let mut bytes = match self.waiting.take() {
            Some(Outgoing { header, bytes }) => {
                let iteration = header.iteration;
                tracing::warn!(
                    iteration,
                    "a snapshot was given up: the one before is not sent yet"
                );
                bytes
            }
            None => std::mem::take(&mut self.spare),
        };
        write(&mut bytes);
        let place = if self.sending.is_none() { &mut self.sending } else { &mut self.waiting };
        *place = Some(Outgoing { header, bytes });
    }

    /// Sends the next pieces as long as there is room for them. `send` returns the offset of the piece after
    /// the one at `header.offset`, or the same if there is no room.
    pub(super) fn send<E>(
        &mut self,
        mut send: impl FnMut(SnapshotHeader, &[u8]) -> Result<u64, E>,
    ) -> Result<(), E> {
        for _ in 0..PIECES {
            let Some(Outgoing { header, bytes }) = &mut self.sending else { break };
            let next = send(*header, bytes)?;
            if next == header.offset {
                break;
            }
            header.offset = next;
            if next >= bytes.len() as u64 {
                self.spare = std::mem::take(bytes);
                self.sending = self.waiting.take();
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn put(outbox: &mut Outbox, iteration: u64) {
        let header = SnapshotHeader { iteration, ..SnapshotHeader::default() };
        outbox.put(header, |bytes| {
            bytes.clear();
            bytes.extend_from_slice(&[iteration.to_le_bytes()[0]; 5]);
        });
    }

    /// Sends pieces of a byte; returns those that the receiver took.
    fn send(outbox: &mut Outbox, mut room: usize) -> Vec<u8> {
        let mut taken = Vec::new();
        let sent = outbox.send(|header, bytes| {
            if room == 0 {
                return Ok(header.offset);
            }
            room -= 1;
            taken.push(bytes[usize::try_from(header.offset).expect("short")]);
            Ok::<_, Infallible>(header.offset + 1)
        });
        sent.expect("never fails");
        taken
    }

    /// Every snapshot that was taken was kept until it was sent, however many there were.
    #[test]
    fn a_receiver_that_stands_still_costs_snapshots_and_no_memory() {
        let mut outbox = Outbox::new(Vec::new());
        put(&mut outbox, 1);
        assert_eq!(send(&mut outbox, 2), [1, 1]);
        for iteration in [2, 3, 3, 4] {
            put(&mut outbox, iteration);
        }
        assert_eq!(send(&mut outbox, 0), [0; 0]);
        // What is on its way is sent to its end, and then the newest.
        assert_eq!(send(&mut outbox, 9), [1, 1, 1, 4]);
        put(&mut outbox, 4);
        assert_eq!(send(&mut outbox, 9), [4, 4, 4, 4]);
        assert!(outbox.is_empty());
        put(&mut outbox, 5);
        assert!(!outbox.is_empty());
        assert_eq!(send(&mut outbox, 9), [5, 5, 5, 5]);
    }
}
