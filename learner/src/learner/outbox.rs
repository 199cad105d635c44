//! Snapshots that wait to be sent: the one on its way, and others as far as there is memory for them.
//!
//! A coordinator that stands still takes nothing, and a state may take longer to send than iterations take to
//! train. Then the oldest that wait are given up, as they are where a disk is slower than the training: a snapshot
//! that is committed later serves whoever asked for an earlier one. **Small states wait in numbers:** a training that
//! is done in a moment loses none of them on a machine that is busy with something else.

use std::collections::VecDeque;

use channels::{PIECE_BUFFER, WAITING_SNAPSHOTS};
use proto::layout::SnapshotHeader;

/// Snapshots on their way.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    sending: Option<Outgoing>,
    /// Others, the oldest first.
    waiting: VecDeque<Outgoing>,
    /// Memory of a snapshot that has been sent or given up, for the next one.
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
        let newest = self.waiting.back().or(self.sending.as_ref());
        if newest.is_some_and(|newest| newest.header.iteration == header.iteration) {
            return;
        }
        self.make_room();
        let mut bytes = std::mem::take(&mut self.spare);
        write(&mut bytes);
        let snapshot = Outgoing { header, bytes };
        if self.sending.is_none() {
            self.sending = Some(snapshot);
        } else {
            self.waiting.push_back(snapshot);
        }
    }

    /// Gives up the oldest that wait, until there is memory for one more.
    fn make_room(&mut self) {
        // All states of a training are as long as each other.
        let next = self.sending.as_ref().map_or(0, |sending| sending.bytes.len());
        let mut waiting: usize = self.waiting.iter().map(|waiting| waiting.bytes.len()).sum();
        while waiting + next > WAITING_SNAPSHOTS
            && let Some(Outgoing { header, bytes }) = self.waiting.pop_front()
        {
            let iteration = header.iteration;
            tracing::warn!(iteration, "a snapshot was given up: those before are not sent yet");
            waiting -= bytes.len();
            self.spare = bytes;
        }
    }

    /// Sends the next pieces as long as there is room for them. `send` returns the offset of the piece after
    /// the one at `header.offset`, or the same if there is no room.
    pub(super) fn send<E>(
        &mut self,
        mut send: impl FnMut(SnapshotHeader, &[u8]) -> Result<u64, E>,
    ) -> Result<(), E> {
        // Blocks that arrive wait meanwhile.
        for _ in 0..PIECE_BUFFER {
            let Some(Outgoing { header, bytes }) = &mut self.sending else { break };
            let next = send(*header, bytes)?;
            if next == header.offset {
                break;
            }
            header.offset = next;
            if next >= bytes.len() as u64 {
                self.spare = std::mem::take(bytes);
                self.sending = self.waiting.pop_front();
                // The next one in its turn: a disk takes them one after another.
                break;
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
            bytes.extend_from_slice(&[iteration.to_le_bytes()[0]; 3]);
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

    /// A short training on a busy machine lost checkpoints that were planned.
    #[test]
    fn small_snapshots_wait_for_each_other() {
        let mut outbox = Outbox::new(Vec::new());
        put(&mut outbox, 1);
        assert_eq!(send(&mut outbox, 2), [1, 1]);
        for iteration in [2, 3, 3, 4] {
            put(&mut outbox, iteration);
        }
        assert_eq!(send(&mut outbox, 0), [0; 0]);
        let mut taken = Vec::new();
        while !outbox.is_empty() {
            taken.extend(send(&mut outbox, 9));
        }
        assert_eq!(taken, [1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
        put(&mut outbox, 4);
        assert_eq!(send(&mut outbox, 9), [4, 4, 4]);
        assert!(outbox.is_empty());
    }

    /// Every snapshot that was taken was kept until it was sent, however long they were.
    #[test]
    fn a_receiver_that_stands_still_costs_snapshots_and_no_memory() {
        let kept = |len: usize| {
            let mut outbox = Outbox::new(Vec::new());
            for iteration in 1..=4 {
                let header = SnapshotHeader { iteration, ..SnapshotHeader::default() };
                // Memory that is never touched.
                outbox.put(header, |bytes| *bytes = vec![0; len]);
            }
            let mut taken = Vec::new();
            while !outbox.is_empty() {
                let sent = outbox.send(|header, bytes| {
                    taken.push(header.iteration);
                    Ok::<_, Infallible>(bytes.len() as u64)
                });
                sent.expect("never fails");
            }
            taken
        };
        // What is on its way is sent to its end, and then the newest.
        assert_eq!(kept(WAITING_SNAPSHOTS / 2), [1, 3, 4]);
        assert_eq!(kept(WAITING_SNAPSHOTS / 2 + 1), [1, 4]);
        assert_eq!(kept(WAITING_SNAPSHOTS + 1), [1, 4]);
    }
}
