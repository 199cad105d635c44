//! What comes from other machines: pieces of answers, and the words of hub and host. The first byte chooses which.

#![no_main]

use std::collections::BTreeMap;

use libfuzzer_sys::fuzz_target;
use proto::gateway::pieces::{Assembly, Content, PIECE_LEN, PieceHead, split};
use proto::gateway::wire::{Answer, Build, Hello, HostBeat, HubBeat, Welcome};
use proto::message::{EvaluationChunk, Order, decode, encode};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Longest answer (bytes).
const MOST: usize = 3 * PIECE_LEN;

/// Pieces of one answer: a flag, the length of a head and the head; then, as the flag says, the piece that fits it, all
/// of whose bytes are the flag, or the length of a piece and the piece.
fn pieces(mut bytes: &[u8]) {
    let mut assembly = Assembly::<Vec<u8>>::new();
    let mut accepted = BTreeMap::new();
    while let Some((&flag, rest)) = bytes.split_first() {
        let (head, rest) = part(rest);
        let fitting = decode::<PieceHead>(head).ok().filter(|_| flag % 2 == 0);
        if let Some(head) = fitting {
            let len = head.total.saturating_sub(head.offset).min(PIECE_LEN as u64) as usize;
            let piece = vec![flag; len];
            // The checksum by another way than the reader's.
            let (own, _) = split(&Content::Status, &piece)
                .pop()
                .unwrap_or_else(|| (PieceHead { checksum: 0, ..head.clone() }, Vec::new()));
            let head = PieceHead { checksum: own.checksum, ..head };
            if assembly.add(&encode(&head), piece, MOST).is_ok() {
                accepted.insert(head.offset as usize, (flag, len));
            }
            bytes = rest;
        } else {
            let (piece, rest) = part(rest);
            if assembly.add(head, piece.to_vec(), MOST).is_ok() {
                let head = decode::<PieceHead>(head).expect("was taken");
                assert!(head.total <= MOST as u64);
                // Its bytes are not one byte: what is written is not compared.
                return;
            }
            bytes = rest;
        }
    }
    let received: usize = accepted.values().map(|(_, len)| len).sum();
    let Some((_, len)) = assembly.whole() else { return };
    assert_eq!((received, assembly.missing()), (len, 0));
    let mut whole = vec![1; len];
    assembly.copy_to(&mut whole);
    for (at, (flag, len)) in accepted {
        assert!(whole[at..at + len].iter().all(|byte| *byte == flag));
    }
}

/// As many bytes as the first says, or all there are, and the rest.
fn part(bytes: &[u8]) -> (&[u8], &[u8]) {
    let Some((&len, rest)) = bytes.split_first() else { return (&[], &[]) };
    rest.split_at(usize::from(len).min(rest.len()))
}

fn again<M: Serialize + DeserializeOwned>(bytes: &[u8]) {
    let Ok(message) = decode::<M>(bytes) else { return };
    let first = encode(&message);
    assert_eq!(encode(&decode::<M>(&first).expect("what was encoded decodes")), first);
}

fn words(bytes: &[u8]) {
    again::<HubBeat>(bytes);
    again::<HostBeat>(bytes);
    again::<PieceHead>(bytes);
    if let Ok(hello) = serde_json::from_slice::<Hello>(bytes) {
        let text = serde_json::to_vec(&hello).expect("it has a JSON form");
        assert_eq!(serde_json::from_slice::<Hello>(&text).expect("its own"), hello);
        let _ = hello.build.difference(&build());
    }
    if let Ok(Answer::Welcome(welcome)) = serde_json::from_slice(bytes) {
        let _ = welcome.digest == Welcome::digest_of(&welcome.config, &welcome.robot);
    }
}

fn build() -> Build {
    Build { version: "1".to_owned(), layout: "ab".to_owned(), sim_worker: "0".repeat(64) }
}

fn json(value: &impl Serialize) -> Vec<u8> {
    [vec![b'w'], serde_json::to_vec(value).expect("it has a JSON form")].concat()
}

fn seeds() -> Vec<Vec<u8>> {
    let chunk = EvaluationChunk { policy_version: 1, first: 0, episodes: 16 };
    let order = encode(&Order::Evaluate { worker: 1, incarnation: 2, episodes: chunk });
    let mut answer = vec![b'p'];
    let bytes = vec![2; 2 * PIECE_LEN + 5];
    for (head, _) in split(&Content::Block(vec![7; 40]), &bytes) {
        let head = encode(&head);
        answer.extend([2, head.len() as u8]);
        answer.extend(head);
    }
    let mut small = vec![b'p'];
    for (head, piece) in split(&Content::Policy(3), &order) {
        let head = encode(&head);
        small.extend([1, head.len() as u8]);
        small.extend(head);
        small.push(piece.len() as u8);
        small.extend(piece);
    }
    let word = |bytes: Vec<u8>| [vec![b'w'], bytes].concat();
    vec![
        answer,
        small,
        word(encode(&HubBeat {
            session: "0123456789ab".to_owned(),
            policies: vec![3, 4],
            hosts: vec![(1, 4), (2, 1)],
            end: None,
        })),
        word(encode(&HostBeat { workers: vec![0, 1, 7] })),
        json(&Hello {
            name: "lab-2".to_owned(),
            workers: 2,
            build: build(),
            processor: "a processor".to_owned(),
        }),
        json(&Answer::Refused("why".to_owned())),
        json(&Answer::Welcome(Welcome {
            session: "0123456789ab".to_owned(),
            host: 1,
            config: "[task]".to_owned(),
            robot: "[base]".to_owned(),
            digest: Welcome::digest_of("[task]", "[base]"),
        })),
    ]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        match bytes.split_first() {
            Some((kind, rest)) if kind % 2 == 0 => pieces(rest),
            Some((_, rest)) => words(rest),
            None => {}
        }
    }
);
