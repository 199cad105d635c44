//! Control messages: whatever decodes is encoded to bytes that decode to the same.

#![no_main]

use libfuzzer_sys::fuzz_target;
use proto::Digest;
use proto::message::{IterationReport, Order, Progress, RunEnd, Status, decode, encode};
use serde::Serialize;
use serde::de::DeserializeOwned;

fn check<M: Serialize + DeserializeOwned>(bytes: &[u8]) {
    let Ok(message) = decode::<M>(bytes) else { return };
    let first = encode(&message);
    // Compared as bytes: a message may hold numbers that equal nothing, themselves included.
    let again = decode::<M>(&first).expect("what was encoded decodes");
    assert_eq!(encode(&again), first);
}

fn seeds() -> Vec<Vec<u8>> {
    let report = IterationReport {
        returns: vec![1.0; 8],
        digest: Digest([7; 16]),
        ..IterationReport::default()
    };
    vec![
        encode(&Order::Rollout {
            worker: 1,
            incarnation: 2,
            iteration: 300,
            policy_version: 299,
            shards: vec![0, 1, 70_000],
        }),
        encode(&Order::Stop(RunEnd::Over)),
        encode(&Progress::IterationDone(Box::new(report))),
        encode(&Progress::Failed { message: "words".to_owned() }),
        encode(&Status::Ready { worker: 1, incarnation: 2, orders: 3 }),
        encode(&Status::BlockDone {
            worker: 1,
            incarnation: 2,
            iteration: 3,
            shard: 4,
            env_steps: 32,
            rollout_ns: 1 << 40,
        }),
    ]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        check::<Order>(bytes);
        check::<Progress>(bytes);
        check::<Status>(bytes);
    }
);
