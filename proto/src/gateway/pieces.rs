//! Large answers in pieces, and how they are put together again.
//!
//! A piece is the payload of a reply; its [`PieceHead`] travels as the attachment. One message of many megabytes would
//! be cut up by the network as well, but then all others wait for its end.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::message;

/// Longest piece (bytes).
pub const PIECE_LEN: usize = 256 << 10;

/// What an answer holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Content {
    /// A block, with the bytes of its header.
    Block(Vec<u8>),
    /// A policy of this version.
    Policy(u64),
    /// An encoded [`Status`](crate::message::Status).
    Status,
}

/// Where a piece belongs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PieceHead {
    /// What the whole answer holds.
    pub content: Content,
    /// Where the piece begins in it (bytes).
    pub offset: u64,
    /// Length of the whole answer (bytes).
    pub total: u64,
    /// CRC-32C of the piece.
    pub checksum: u32,
}

/// Cuts an answer up. The bytes are copied once, here.
pub fn split(content: &Content, bytes: &[u8]) -> Vec<(PieceHead, Vec<u8>)> {
    let total = bytes.len() as u64;
    let pieces = bytes.chunks(PIECE_LEN).enumerate().map(|(index, piece)| {
        let offset = (index * PIECE_LEN) as u64;
        let checksum = crc32c::crc32c(piece);
        (PieceHead { content: content.clone(), offset, total, checksum }, piece.to_vec())
    });
    pieces.collect()
}

/// What has come of an answer.
#[derive(Debug, Default)]
pub struct Assembly<P> {
    whole: Option<(Content, u64)>,
    pieces: BTreeMap<u64, P>,
    received: u64,
}

/// Bytes that lie in one place or in several.
pub trait Payload {
    /// The places, in order.
    fn slices(&self) -> impl Iterator<Item = &[u8]>;
}

impl Payload for Vec<u8> {
    fn slices(&self) -> impl Iterator<Item = &[u8]> {
        std::iter::once(self.as_slice())
    }
}

impl<P: Payload> Assembly<P> {
    /// Nothing yet.
    pub fn new() -> Self {
        Self { whole: None, pieces: BTreeMap::new(), received: 0 }
    }

    /// Takes a piece with its encoded head, of an answer of at most `most` bytes. A piece that does not belong is
    /// refused and counts as one that has not come.
    pub fn add(&mut self, head: &[u8], piece: P, most: usize) -> Result<(), String> {
        let head: PieceHead = message::decode(head)?;
        let len: u64 = piece.slices().map(|slice| slice.len() as u64).sum();
        let checksum = piece.slices().fold(0, crc32c::crc32c_append);
        if head.checksum != checksum {
            return Err(format!("piece at {} is damaged: its checksum is another", head.offset));
        }
        let expected = (head.total.saturating_sub(head.offset)).min(PIECE_LEN as u64);
        // An empty piece would fit anywhere beyond the end.
        if head.total > most as u64
            || expected == 0
            || !head.offset.is_multiple_of(PIECE_LEN as u64)
            || len != expected
        {
            return Err(format!(
                "piece at {} of {} is not where it can be",
                head.offset, head.total
            ));
        }
        let (content, total) = self.whole.get_or_insert((head.content.clone(), head.total));
        if (&head.content, head.total) != (&*content, *total) {
            return Err("piece of another answer".to_owned());
        }
        if self.pieces.insert(head.offset, piece).is_none() {
            self.received += len;
        }
        Ok(())
    }

    /// Pieces that have not come; at least one while nothing has.
    pub fn missing(&self) -> u64 {
        match &self.whole {
            None => 1,
            Some((_, total)) => {
                total.div_ceil(PIECE_LEN as u64).saturating_sub(self.pieces.len() as u64)
            }
        }
    }

    /// What the answer holds and how long it is, if it is whole.
    pub fn whole(&self) -> Option<(&Content, usize)> {
        let (content, total) = self.whole.as_ref()?;
        (self.received == *total).then_some((content, *total as usize))
    }

    /// Writes a whole answer to `to`, which is as long.
    pub fn copy_to(&self, to: &mut [u8]) {
        for (&offset, piece) in &self.pieces {
            let mut at = offset as usize;
            for slice in piece.slices() {
                to[at..at + slice.len()].copy_from_slice(slice);
                at += slice.len();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Heads and pieces.
    type Encoded = Vec<(Vec<u8>, Vec<u8>)>;

    fn pieces(len: usize) -> (Vec<u8>, Encoded) {
        let bytes: Vec<u8> = (0..len).map(|i| (i * 31 % 251) as u8).collect();
        let cut = split(&Content::Policy(3), &bytes);
        let encoded = cut.into_iter().map(|(head, piece)| (message::encode(&head), piece));
        (bytes, encoded.collect())
    }

    #[test]
    fn pieces_in_any_order_and_twice_become_the_whole() {
        for len in [1, PIECE_LEN, PIECE_LEN + 1, 3 * PIECE_LEN + 5] {
            let (bytes, pieces) = pieces(len);
            let mut assembly = Assembly::new();
            assert_eq!((assembly.missing(), assembly.whole().is_none()), (1, true));
            for (head, piece) in pieces.iter().rev().chain(&pieces) {
                assembly.add(head, piece.clone(), len).expect("belongs");
            }
            assert_eq!(assembly.whole(), Some((&Content::Policy(3), len)));
            assert_eq!(assembly.missing(), 0);
            let mut copy = vec![0; len];
            assembly.copy_to(&mut copy);
            assert_eq!(copy, bytes);
        }
    }

    #[test]
    fn what_is_damaged_or_foreign_is_refused_and_missing() {
        let len = 2 * PIECE_LEN;
        let (_, pieces) = pieces(len);
        let mut assembly = Assembly::new();
        let [(first, bytes), (second, rest)] = &pieces[..] else { panic!("two pieces") };
        let mut damaged = bytes.clone();
        damaged[7] ^= 1;
        assert!(assembly.add(first, damaged, len).is_err_and(|why| why.contains("damaged")));
        assert!(assembly.add(first, bytes.clone(), len - 1).is_err(), "longer than it can be");
        assert!(assembly.add(b"?", bytes.clone(), len).is_err());
        assembly.add(first, bytes.clone(), len).expect("belongs");
        let other =
            PieceHead { content: Content::Status, ..message::decode(second).expect("a head") };
        assert!(assembly.add(&message::encode(&other), rest.clone(), len).is_err());
        let beyond = PieceHead { offset: len as u64 * 2, ..other };
        assert!(assembly.add(&message::encode(&beyond), rest.clone(), len).is_err());
        let empty = PieceHead { content: Content::Policy(3), checksum: 0, ..beyond };
        assert!(assembly.add(&message::encode(&empty), Vec::new(), len).is_err());
        assert_eq!((assembly.missing(), assembly.whole()), (1, None));
    }
}
