//! Archives of checkpoints. An input that begins with `r` is a tar file as it comes; of any other
//! one an archive is made whose lengths and hashes are right, so that what lies behind them is
//! reached: the input's parts become its files.

#![no_main]

use std::borrow::Cow;

use libfuzzer_sys::fuzz_target;
use tar::{Builder, Header};

const FILES: [&str; 4] = ["config.toml", "policy.safetensors", "robot.toml", "state.safetensors"];
/// Ends a part of an input.
const END: &[u8] = b"\0--\0";

fn append(builder: &mut Builder<Vec<u8>>, name: &str, bytes: &[u8]) {
    let mut header = Header::new_ustar();
    header.set_path(format!("seed/{name}")).expect("a short name");
    header.set_size(bytes.len() as u64);
    header.set_mode(0o644);
    header.set_cksum();
    builder.append(&header, bytes).expect("memory can be written");
}

fn archive(files: &[(&str, &[u8])], manifest: &[u8]) -> Vec<u8> {
    let mut builder = Builder::new(Vec::new());
    append(&mut builder, "manifest.json", manifest);
    for (name, bytes) in files {
        append(&mut builder, name, bytes);
    }
    builder.into_inner().expect("memory can be written")
}

fn parts(bytes: &[u8]) -> Vec<&[u8]> {
    let mut parts = Vec::new();
    let mut rest = bytes;
    while let Some(end) = rest.windows(END.len()).position(|window| window == END) {
        parts.push(&rest[..end]);
        rest = &rest[end + END.len()..];
    }
    parts.push(rest);
    parts
}

fn contents() -> [Vec<u8>; 4] {
    [
        fuzz::small_config().to_toml().into_bytes(),
        fuzz::tensors("", &[]),
        fuzz::robot_toml().into_bytes(),
        fuzz::state(),
    ]
}

fn seeds() -> Vec<Vec<u8>> {
    let contents = contents();
    let files: Vec<(&str, &[u8])> =
        FILES.into_iter().zip(&contents).map(|(name, bytes)| (name, &bytes[..])).collect();
    let manifest = fuzz::manifest(&files).to_string();
    let raw = [b"r", &archive(&files, manifest.as_bytes())[..]].concat();
    let all = [b"m", &contents.join(END)[..]].concat();
    let without_state = [b"m", &contents[..3].join(END)[..]].concat();
    vec![raw, all, without_state]
}

/// The tar file that an input stands for.
fn tar(input: &[u8]) -> Option<Cow<'_, [u8]>> {
    let (kind, bytes) = input.split_first()?;
    if *kind == b'r' {
        return Some(bytes.into());
    }
    let files: Vec<(&str, &[u8])> = FILES.into_iter().zip(parts(bytes)).collect();
    Some(archive(&files, fuzz::manifest(&files).to_string().as_bytes()).into())
}

/// Every seed is a whole checkpoint: otherwise nothing behind a successful import is reached.
fn check_seeds() {
    for seed in seeds() {
        let tar = tar(&seed).expect("a seed is not empty");
        if let Err(error) = fuzz::empty_store("archives").import(&tar[..], None) {
            panic!("a seed is refused: {error}");
        }
    }
}

fuzz_target!(
    init: {
        check_seeds();
        fuzz::write_seeds(seeds);
    },
    |bytes: &[u8]| {
        let Some(tar) = tar(bytes) else { return };
        let store = fuzz::empty_store("archives");
        let imported = store.import(&tar[..], None);
        let entries = store.entries().expect("the store is readable whatever came");
        match imported {
            Ok(entry) => {
                let mut first = Vec::new();
                store.export(&entry.name, &mut first).expect("what came in goes out");
                let again = store.import(&first[..], None).expect("the same twice is no error");
                assert_eq!(again.name, entry.name);
            }
            Err(_) => assert!(entries.is_empty(), "a refused archive left {entries:?}"),
        }
    }
);
