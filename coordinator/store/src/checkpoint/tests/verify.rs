use proto::agents::Joints;
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
    rewritten(bytes, |tensors, _| {
        *tensors = std::mem::take(tensors)
            .into_iter()
            .map(|(mut name, mut tensor)| {
                edit(&mut name, &mut tensor.2);
                (name, tensor)
            })
            .collect();
    })
}

/// What is done to tensors and format mark.
type Change<'a> = Box<dyn Fn(&mut Tensors, &mut String) + 'a>;

/// Tensors by name: type, shape, bytes.
type Tensors = BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>;

/// A safetensors file with anything in it changed, the format mark included.
fn rewritten(bytes: &[u8], rewrite: impl Fn(&mut Tensors, &mut String)) -> Vec<u8> {
    let file = SafeTensors::deserialize(bytes).expect("whole");
    let (_, metadata) = SafeTensors::read_metadata(bytes).expect("whole");
    let metadata = metadata.metadata().clone().unwrap_or_default();
    let mut format = metadata.get("format").cloned().unwrap_or_default();
    let tensor = |view: TensorView<'_>| (view.dtype(), view.shape().to_vec(), view.data().to_vec());
    let mut tensors: Tensors =
        file.tensors().into_iter().map(|(name, view)| (name, tensor(view))).collect();
    rewrite(&mut tensors, &mut format);
    let views = tensors.iter().map(|(name, (dtype, shape, data))| {
        (name.clone(), TensorView::new(*dtype, shape.clone(), data).expect("sized"))
    });
    let metadata = (!format.is_empty()).then(|| HashMap::from([("format".to_owned(), format)]));
    safetensors::serialize(views, metadata).expect("serialises")
}

/// The digest that a learner would compute for a state.
fn digest_of(state: &[u8]) -> proto::Digest {
    let mut digest = DigestBuilder::new();
    let file = SafeTensors::deserialize(state).expect("whole");
    let tensors: BTreeMap<_, _> = file.tensors().into_iter().collect();
    for (name, view) in &tensors {
        digest.field(name, view.data());
    }
    digest.finish()
}

#[test]
fn a_whole_checkpoint_passes() {
    let (_dir, store) = store_with(&[1]);
    let found = store.verify(&nth(1)).expect("there");
    assert!(found.is_whole(), "{:?}", found.problems);
    let layout = ActorLayout::new(&config(), &Dimensions::new(&config(), Joints::of_sixes(4)));
    let state = StateLayout::new(&config(), &Dimensions::new(&config(), Joints::of_sixes(4)));
    let tensors = state.tensors.len() + layout.tensors.len();
    assert_eq!((found.files, found.tensors), (4, tensors));
    assert!(matches!(store.verify(&nth(2)), Err(CheckpointError::Absent { .. })));
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
fn a_number_that_is_not_finite_is_found_wherever_it_is() {
    for (file, tensor, last) in [
        (POLICY, "head.bias", false),
        (STATE, "actor.head.weight", false),
        (STATE, "actor.head.weight", true),
    ] {
        let problems = problems_after(file, |bytes| {
            edited(bytes, |name, data| {
                if name == tensor {
                    let at = if last { data.len() - 4 } else { 0 };
                    data[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
                }
            })
        });
        assert!(problems.contains(tensor) && problems.contains("not finite"), "{problems}");
    }
}

#[test]
fn a_tensor_of_several_pieces_is_read_to_its_end() {
    let (_dir, store) = store();
    let config = config_with(&["network.critic_hidden=[512]"]);
    let dir = commit_of(&store, &config, &snapshot_of(&config, 1, 0.0));
    assert!(store.verify(&nth(1)).expect("there").is_whole());
    let bytes = std::fs::read(dir.join(STATE)).expect("read");
    for position in [1 << 20, 2 << 20, 2_800_000] {
        let changed = edited(&bytes, |name, data| {
            if name == "critic.hidden.0.weight" {
                data[position..position + 4].copy_from_slice(&f32::INFINITY.to_le_bytes());
            }
        });
        recommit(&dir, STATE, &changed);
        let problems = store.verify(&nth(1)).expect("there").problems.join("\n");
        assert!(problems.contains("not finite") && problems.contains("digest"), "{problems}");
    }
}

#[test]
fn a_header_that_lies_is_refused() {
    let header = |text: &str, data: usize| {
        let mut bytes = (text.len() as u64).to_le_bytes().to_vec();
        bytes.extend_from_slice(text.as_bytes());
        bytes.resize(bytes.len() + data, 0);
        bytes
    };
    let one = |from: usize, to: usize| {
        format!(r#"{{"a":{{"dtype":"F32","shape":[1],"data_offsets":[{from},{to}]}}}}"#)
    };
    let huge =
        r#"{"a":{"dtype":"F32","shape":[4294967296,4294967296,4294967296],"data_offsets":[0,4]}}"#;
    for (what, bytes, word) in [
        ("no bytes", Vec::new(), "fill"),
        ("a longer header than the file", [&9_u64.to_le_bytes()[..], b"{}"].concat(), "fill"),
        ("an endless header", u64::MAX.to_le_bytes().to_vec(), "more than"),
        ("no JSON", header("what", 0), "not that of safetensors"),
        ("a gap", header(&one(4, 8), 8), "not that of safetensors"),
        ("another length", header(&one(0, 8), 8), "not that of safetensors"),
        ("too many numbers", header(huge, 4), "not that of safetensors"),
        ("bytes too many", header(&one(0, 4), 5), "its header says"),
        ("bytes too few", header(&one(0, 4), 3), "its header says"),
    ] {
        let problems = problems_after(STATE, |_| bytes.clone());
        assert!(problems.contains(word), "{what}: {problems}");
    }
    problems_after(STATE, |_| header(&one(0, 4), 4));
}

#[test]
fn a_policy_that_does_not_fit_is_found() {
    let problems = problems_after(POLICY, |bytes| {
        edited(bytes, |name, _| {
            if name == "head.bias" {
                *name = "extra".to_owned();
            }
        })
    });
    assert!(problems.contains("`head.bias` is missing"), "{problems}");
    assert!(problems.contains("`extra` is unknown"), "{problems}");

    let problems =
        problems_after(CONFIG, |_| config_with(&["network.hidden=[8]"]).to_toml().into_bytes());
    assert!(problems.contains("the configuration wants F32 [8, 48, 8]"), "{problems}");
    let problems = problems_after(ROBOT, |_| b"name = 3".to_vec());
    assert!(problems.contains(ROBOT), "{problems}");
}

#[test]
fn a_state_that_is_not_what_the_manifest_says_is_found() {
    let change = |tensor: &'static str, change: fn(&mut String, &mut Vec<u8>)| {
        problems_after(STATE, move |bytes| {
            edited(bytes, |name, data| {
                if name.starts_with(tensor) {
                    change(name, data);
                }
            })
        })
    };
    let problems = change("actor", |_, data| data[0] ^= 1);
    assert!(problems.contains("digest") && problems.contains("manifest says"), "{problems}");
    let problems = change("counters.iteration", |_, data| data[0] = 9);
    assert!(problems.contains("`counters.iteration` is 9, not 1"), "{problems}");
    let problems = change("actor.head.bias", |name, _| *name = "policy.x".to_owned());
    assert!(problems.contains("`policy.x` belongs into policy.safetensors"), "{problems}");
    let problems = problems_after(STATE, |bytes| bytes[..bytes.len() - 1].to_vec());
    assert!(problems.contains(STATE), "{problems}");
}

/// Well hashed, but no learner has ever written it. All but two of these were once taken in.
#[test]
fn a_state_without_sense_is_neither_whole_nor_taken_in() {
    let zeros = |tensors: &mut Tensors, wanted: fn(&str) -> bool| {
        for (_, (.., bytes)) in tensors.iter_mut().filter(|(name, _)| wanted(name)) {
            bytes.fill(0);
        }
    };
    let retyped = |name: &'static str, dtype: Dtype| -> Change<'static> {
        Box::new(move |tensors, _| tensors.get_mut(name).expect(name).0 = dtype)
    };
    let first = |name: &'static str, number: f64| -> Change<'static> {
        Box::new(move |tensors, _| {
            let (dtype, _, bytes) = tensors.get_mut(name).expect(name);
            match dtype {
                Dtype::F32 => bytes[..4].copy_from_slice(&(number as f32).to_le_bytes()),
                Dtype::F64 => bytes[..8].copy_from_slice(&number.to_le_bytes()),
                Dtype::I64 => bytes[..8].copy_from_slice(&(number as i64).to_le_bytes()),
                _ => bytes[..8].copy_from_slice(&(number as u64).to_le_bytes()),
            }
        })
    };
    let cases: Vec<(&str, Change<'_>)> = vec![
        ("its format is `none`", Box::new(|_, format| format.clear())),
        ("its format is `pt`", Box::new(|_, format| "pt".clone_into(format))),
        ("`critic.head.bias` is missing", Box::new(|t, _| drop(t.remove("critic.head.bias")))),
        ("`counters.iteration` is missing", Box::new(|t, _| drop(t.remove("counters.iteration")))),
        (
            "`actor.extra` is unknown",
            Box::new(|t, _| drop(t.insert("actor.extra".into(), (Dtype::F32, vec![], vec![0; 4])))),
        ),
        (
            "`critic.head.bias` is F32 [1, 8], the configuration wants F32 [8, 1]",
            Box::new(|t, _| t.get_mut("critic.head.bias").expect("there").1 = vec![1, 8]),
        ),
        ("`critic.adam.steps` is U64", retyped("critic.adam.steps", Dtype::U64)),
        ("`critic.head.bias` is I32", retyped("critic.head.bias", Dtype::I32)),
        ("`counters.env_steps` is 5, not", first("counters.env_steps", 5.0)),
        ("`counters.precision` is 8, expected 16 or 32", first("counters.precision", 8.0)),
        (
            "`critic.head.weight` holds a number that is not finite",
            first("critic.head.weight", f64::NAN),
        ),
        ("`critic.adam.v.head.bias` holds a negative", first("critic.adam.v.head.bias", -1.0)),
        ("`actor.adam.steps` holds a negative", first("actor.adam.steps", -1.0)),
        ("`value_norm.debias` holds a number outside", first("value_norm.debias", 1.5)),
        (
            "`critic.hidden.0.weight` holds nothing but zeros",
            Box::new(|t, _| zeros(t, |name| name.starts_with("critic."))),
        ),
        (
            "`actor.hidden.0.weight` holds nothing but zeros",
            Box::new(|t, _| zeros(t, |name| !name.starts_with("counters."))),
        ),
        ("`actor.head.bias` is not `head.bias` of policy", first("actor.head.bias", 77.0)),
    ];
    let (_source_dir, source) = store_with(&[1]);
    let dir = source.dir(&nth(1));
    let whole = std::fs::read(dir.join(STATE)).expect("read");
    for (problem, change) in cases {
        let state = rewritten(&whole, change);
        recommit(&dir, STATE, &state);
        let mut manifest = Manifest::read(&dir).expect("reads");
        manifest.digest = digest_of(&state);
        std::fs::write(dir.join(MANIFEST), manifest.to_json()).expect("write");
        let found = source.verify(&nth(1)).expect("there").problems.join("\n");
        assert!(found.contains(problem), "`{problem}` is not in\n{found}");
        assert!(!found.contains("digest"), "well hashed: {found}");
        let (_dir, store) = super::store();
        let error = store.import(&packed(&source, &nth(1))[..], None).expect_err(problem);
        assert!(matches!(error, CheckpointError::Archive { .. }), "{problem}: {error}");
        assert!(contents(store.root()).is_empty(), "{problem}");
    }
}

#[test]
fn the_arithmetic_of_a_state_is_that_of_its_configuration() {
    for (precision, problem) in
        [("auto", None), ("f32", None), ("bf16", Some("`counters.precision` is 32, expected 16"))]
    {
        let (_dir, store) = store();
        let config = config_with(&[&format!("run.precision={precision}")]);
        // A learner of single precision.
        commit_of(&store, &config, &snapshot_of(&config, 1, 0.0));
        let problems = store.verify(&nth(1)).expect("there").problems;
        assert_eq!(problems.is_empty(), problem.is_none(), "{precision}: {problems:?}");
        assert!(problems.iter().all(|found| found.contains(problem.expect("one"))), "{problems:?}");
    }
}

/// Actors see inputs by what was published; another than the state's is another policy.
#[test]
fn the_published_normalisation_is_that_of_the_state() {
    let (_dir, store) = store();
    let config = config_with(&["network.input_norm=running", "network.parameter_sharing=none"]);
    let dir = commit_of(&store, &config, &snapshot_of(&config, 1, 0.0));
    let policy = std::fs::read(dir.join(POLICY)).expect("read");
    // As the moments of `snapshot_of` give it: mean, squares and count are all one half.
    let publish = |mean: f32, inverse_std: f32| {
        let policy = edited(&policy, |name, data| {
            let number = match name.as_str() {
                "input.mean" => mean,
                "input.inverse_std" => inverse_std,
                _ => return,
            };
            data.chunks_exact_mut(4).for_each(|bytes| bytes.copy_from_slice(&number.to_le_bytes()));
        });
        recommit(&dir, POLICY, &policy);
        store.verify(&nth(1)).expect("there").problems.join("\n")
    };
    let inverse_std = (1.0_f64 + 1e-6).sqrt().recip() as f32;
    assert_eq!(publish(0.5, inverse_std), "");
    assert_eq!(publish(0.5, inverse_std + f32::EPSILON), "", "rounding is none");
    for (mean, inverse_std, name) in
        [(0.6, inverse_std, "input.mean"), (0.5, 1.1 * inverse_std, "input.inverse_std")]
    {
        let problems = publish(mean, inverse_std);
        assert!(problems.contains(&format!("`observation_norm` is not `{name}`")), "{problems}");
    }
}

#[test]
fn env_steps_are_those_of_the_iterations() {
    let (_dir, store) = store_with(&[1]);
    let dir = store.dir(&nth(1));
    let mut manifest = Manifest::read(&dir).expect("reads");
    manifest.env_steps += 1;
    std::fs::write(dir.join(MANIFEST), manifest.to_json()).expect("write");
    let problems = store.verify(&nth(1)).expect("there").problems.join("\n");
    assert!(problems.contains("env-steps are not those of 1 iterations"), "{problems}");
}

#[test]
fn a_large_state_takes_no_memory() {
    const LARGE: usize = 128 << 20;
    let peak = || -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").expect("readable");
        let line = status.lines().find(|line| line.starts_with("VmHWM:")).expect("a peak");
        line.split_whitespace().nth(1).and_then(|kib| kib.parse().ok()).expect("a number")
    };
    let (_dir, store) = store_with(&[1]);
    let dir = store.dir(&nth(1));
    // A state of zeros, never in memory as a whole: a header, and a hole in the file.
    let header = format!(
        r#"{{"weights":{{"dtype":"F32","shape":[{LARGE}],"data_offsets":[0,{}]}}}}"#,
        4 * LARGE
    );
    let start = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes()].concat();
    std::fs::write(dir.join(STATE), &start).expect("write");
    let len = (start.len() + 4 * LARGE) as u64;
    std::fs::File::options()
        .write(true)
        .open(dir.join(STATE))
        .and_then(|file| file.set_len(len))
        .expect("a hole");
    let (mut hash, mut digest) = (blake3::Hasher::new(), DigestBuilder::new());
    hash.update(&start);
    digest.begin("weights", 4 * LARGE as u64);
    let zeros = vec![0; 1 << 20];
    for _ in 0..4 * LARGE / zeros.len() {
        hash.update(&zeros);
        digest.piece(&zeros);
    }
    let mut manifest = Manifest::read(&dir).expect("reads");
    manifest.digest = digest.finish();
    let entry = FileEntry { len, blake3: hash.finalize().to_hex().to_string() };
    manifest.files.insert(STATE.to_owned(), entry);
    std::fs::write(dir.join(MANIFEST), manifest.to_json()).expect("write");

    let before = peak();
    let found = store.verify(&nth(1)).expect("there");
    // Nothing but that it is none of the configuration.
    let known = |problem: &&String| {
        !["its format", "is missing", "unknown"].iter().any(|word| problem.contains(word))
    };
    assert_eq!(found.problems.iter().find(known), None);
    // The state has 512 MiB. Other tests share this process, and have taken 170 MiB at once.
    assert!(peak() - before < 320 << 10, "{} KiB more", peak() - before);
}
