use safetensors::SafeTensors;

use super::*;

/// Writes a file of a checkpoint anew and the manifest with it, as if it had been committed so.
fn recommit(dir: &Path, file: &str, bytes: &[u8]) {
    let mut manifest = Manifest::read(dir).expect("reads");
    let entry =
        FileEntry { len: bytes.len() as u64, blake3: blake3::hash(bytes).to_hex().to_string() };
    manifest.files.insert(file.to_owned(), entry);
    std::fs::write(dir.join(file), bytes).expect("write");
    std::fs::write(dir.join(MANIFEST), manifest.to_json()).expect("write");
}

/// The problems of a checkpoint whose `file` was changed before its commit.
fn problems_after(file: &str, change: impl Fn(&[u8]) -> Vec<u8>) -> String {
    let (_dir, store) = store_with(&[1]);
    let dir = store.dir(&nth(1));
    let bytes = std::fs::read(dir.join(file)).expect("read");
    recommit(&dir, file, &change(&bytes));
    let found = store.verify(&nth(1)).expect("there");
    assert!(!found.is_whole(), "{file}");
    found.problems.join("\n")
}

/// A safetensors file with a tensor's bytes or name changed.
fn edited(bytes: &[u8], edit: impl Fn(&mut String, &mut Vec<u8>)) -> Vec<u8> {
    let file = SafeTensors::deserialize(bytes).expect("whole");
    let mut tensors: Vec<_> = file
        .tensors()
        .into_iter()
        .map(|(name, view)| (name, view.dtype(), view.shape().to_vec(), view.data().to_vec()))
        .collect();
    for (name, _, _, data) in &mut tensors {
        edit(name, data);
    }
    let views = tensors.iter().map(|(name, dtype, shape, data)| {
        (name.clone(), TensorView::new(*dtype, shape.clone(), data).expect("sized"))
    });
    safetensors::serialize(views, None).expect("serialises")
}

#[test]
fn a_whole_checkpoint_passes() {
    let (_dir, store) = store_with(&[1]);
    let found = store.verify(&nth(1)).expect("there");
    assert!(found.is_whole(), "{:?}", found.problems);
    let layout = ActorLayout::new(&config(), &Dimensions::new(&config(), 4));
    assert_eq!((found.files, found.tensors), (4, 3 + layout.tensors.len()));
    assert!(matches!(store.verify(&nth(2)), Err(CheckpointError::NotFound { .. })));
}

#[test]
fn every_flip_of_a_content_file_is_noticed() {
    let (_dir, store) = store_with(&[1]);
    let dir = store.dir(&nth(1));
    for file in [STATE, POLICY, CONFIG, ROBOT] {
        let path = dir.join(file);
        let whole = std::fs::read(&path).expect("read");
        let mut bytes = whole.clone();
        // A prime stride meets headers, numbers and text at all offsets within a word.
        for position in (0..whole.len()).step_by(61).chain([whole.len() - 1]) {
            bytes[position] ^= 1 << (position % 8);
            std::fs::write(&path, &bytes).expect("write");
            assert!(store.load(&dir).is_err(), "{file} at {position}");
            assert!(!store.verify(&nth(1)).expect("there").is_whole(), "{file} at {position}");
            bytes[position] = whole[position];
        }
        std::fs::write(&path, &whole).expect("write");
    }
    assert!(store.verify(&nth(1)).expect("there").is_whole());
}

#[test]
fn a_flip_in_the_manifest_is_noticed_where_it_means_something() {
    let (_dir, store) = store_with(&[1]);
    let path = store.dir(&nth(1)).join(MANIFEST);
    let whole = std::fs::read_to_string(&path).expect("read");
    let from = whole.find("\"created_unix_s\"").expect("a key");
    let to = whole.find("\"files\"").expect("a key");
    for position in 0..whole.len() {
        let mut bytes = whole.clone().into_bytes();
        // Case: the smallest change that keeps a letter a letter.
        bytes[position] ^= 0x20;
        std::fs::write(&path, &bytes).expect("write");
        let noticed = !store.verify(&nth(1)).expect("there").is_whole();
        let space = whole.as_bytes()[position].is_ascii_whitespace();
        // Time and provenance are remarks that nothing can confirm; hexadecimal digits mean the same
        // in capitals.
        let remark = (from..to).contains(&position);
        let digit = whole.as_bytes()[position].is_ascii_hexdigit();
        assert!(noticed || space || remark || digit, "at {position}: {:?}", &whole[..position]);
    }
}

#[test]
fn what_was_wrong_before_the_commit_is_found_too() {
    let nan = |data: &mut Vec<u8>| data[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let problems = problems_after(POLICY, |bytes| {
        edited(bytes, |name, data| {
            if name == "head.bias" {
                nan(data);
            }
        })
    });
    assert!(problems.contains("head.bias") && problems.contains("not finite"), "{problems}");

    let problems = problems_after(POLICY, |bytes| {
        edited(bytes, |name, _| {
            if name == "head.bias" {
                *name = "extra".to_owned();
            }
        })
    });
    assert!(problems.contains("`head.bias` is missing"), "{problems}");
    assert!(problems.contains("`extra` is unknown"), "{problems}");

    let problems = problems_after(STATE, |bytes| {
        edited(bytes, |name, data| {
            if name.starts_with("actor") {
                data[0] ^= 1;
            }
        })
    });
    assert!(problems.contains("digest") && problems.contains("manifest says"), "{problems}");

    let problems = problems_after(STATE, |bytes| {
        edited(bytes, |name, data| {
            if name == "counters.iteration" {
                data[0] = 9;
            }
        })
    });
    assert!(problems.contains("`counters.iteration` is not 1"), "{problems}");

    let problems = problems_after(STATE, |bytes| {
        edited(bytes, |name, _| {
            if name.starts_with("actor") {
                *name = "policy.x".to_owned();
            }
        })
    });
    assert!(problems.contains("`policy.x` belongs into policy.safetensors"), "{problems}");

    let problems = problems_after(STATE, |bytes| bytes[..bytes.len() - 1].to_vec());
    assert!(problems.contains(STATE), "{problems}");

    let problems =
        problems_after(CONFIG, |_| config_with(&["network.hidden=[8]"]).to_toml().into_bytes());
    assert!(problems.contains("the configuration wants F32 [8, 49, 8]"), "{problems}");

    let problems = problems_after(ROBOT, |_| b"name = 3".to_vec());
    assert!(problems.contains(ROBOT), "{problems}");
}
