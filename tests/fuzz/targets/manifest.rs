//! Manifests and labels of checkpoints. The first byte chooses which.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::json;
use store::checkpoint::{LABELS, Labels, MANIFEST, Manifest};

fn seeds() -> Vec<Vec<u8>> {
    let files: Vec<(&str, &[u8])> = ["config.toml", "policy.safetensors", "robot.toml"]
        .into_iter()
        .map(|name| (name, name.as_bytes()))
        .collect();
    let manifest = fuzz::manifest(&files);
    let labels = json!({
        "pinned": true,
        "tags": ["paper", "v1.0"],
        "score": { "value": 0.5, "errors": { "position": 0.01 }, "episodes": 30, "steps": 200, "seed": 0 },
        "milestone": false,
    });
    vec![format!("m{manifest}").into_bytes(), format!("l{labels}").into_bytes()]
}

fn write(name: &str, text: &[u8]) {
    std::fs::write(fuzz::scratch().join(name), text).expect("temporary files can be written");
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        let Some((kind, text)) = bytes.split_first() else { return };
        if kind % 2 == 0 {
            write(LABELS, text);
            let lenient = Labels::read(fuzz::scratch());
            match Labels::try_read(fuzz::scratch()) {
                Ok(labels) => {
                    let again = serde_json::to_vec(&labels).expect("labels have a JSON form");
                    write(LABELS, &again);
                    assert_eq!(Labels::try_read(fuzz::scratch()).expect("written"), labels);
                }
                Err(_) => assert!(lenient.pinned, "damaged labels must keep their checkpoint"),
            }
        } else {
            write(MANIFEST, text);
            let Ok(manifest) = Manifest::read(fuzz::scratch()) else { return };
            let _ = (manifest.has_state(), manifest.bytes());
            let again = serde_json::to_vec(&manifest).expect("a manifest has a JSON form");
            write(MANIFEST, &again);
            assert_eq!(Manifest::read(fuzz::scratch()).expect("written"), manifest);
        }
    }
);
