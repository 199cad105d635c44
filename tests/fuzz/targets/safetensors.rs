//! Tensor files: the readers of actors, and the way of a snapshot from its pieces to a checkpoint.
//! The first byte chooses which.

#![no_main]

use libfuzzer_sys::fuzz_target;
use proto::agents::Joints;
use proto::layout::SnapshotHeader;
use store::checkpoint::{Assembly, read_policy};

fn seeds() -> Vec<Vec<u8>> {
    let tag = |kind: &[u8], bytes: Vec<u8>| [kind, &bytes].concat();
    vec![
        tag(b"p", fuzz::tensors("", &[])),
        tag(b"q", fuzz::tensors("policy.", &["adam.step"])),
        tag(b"p", fuzz::tensors("", &["surplus"])),
    ]
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        let Some((kind, bytes)) = bytes.split_first() else { return };
        if kind % 2 == 0 {
            let path = fuzz::scratch().join("policy.safetensors");
            std::fs::write(&path, bytes).expect("temporary files can be written");
            let layout = fuzz::layout();
            if let Ok(actors) = read_policy(&path, &layout) {
                assert_eq!(actors.len(), layout.len);
                assert!(actors.iter().all(|number| number.is_finite()));
            }
            return;
        }
        let mut assembly = Assembly::new();
        let mut snapshot = None;
        // In three pieces, as a longer one travels.
        let mut offset = 0;
        for piece in bytes.chunks((bytes.len() / 3).max(1)) {
            let total = bytes.len() as u64;
            let header = SnapshotHeader { iteration: 1, offset, total, digest: [7; 16] };
            snapshot = assembly.add(&header, piece).expect("pieces that follow each other");
            offset += piece.len() as u64;
        }
        let Some(snapshot) = snapshot else { return };
        assert_eq!(snapshot.bytes, bytes);
        let store = fuzz::empty_store("snapshots");
        let config = fuzz::small_config();
        let committed =
            store.commit(&snapshot, &config, &fuzz::robot_toml(), &serde_json::Value::Null);
        if let Ok(dir) = committed {
            let checkpoint = store.load(&dir).expect("what was committed is whole");
            assert_eq!(checkpoint.manifest.iteration, 1);
            let _ = checkpoint.actors(Joints::of_sixes(4));
        }
    }
);
