use proto::agents::Joints;
use proto::config::Precision;
use proto::layout::SnapshotHeader;

use super::*;

#[test]
fn a_committed_snapshot_comes_back() {
    let (_dir, store) = store();
    let path = commit(&store, 7);
    let checkpoint = store.latest().expect("there is one");
    assert_eq!(checkpoint.dir, path);
    assert_eq!(checkpoint.manifest.iteration, 7);
    assert_eq!(checkpoint.manifest.env_steps, 7 * config().steps_per_iteration());
    assert_eq!(checkpoint.config, config());
    let actors = checkpoint.actors(Joints::of_sixes(4)).expect("actors");
    let layout = ActorLayout::new(&config(), &Dimensions::new(&config(), Joints::of_sixes(4)));
    let bias = layout.get("head.bias").expect("every actor has one");
    assert_eq!(actors[bias.offset], bias.offset as f32);
}

#[test]
fn an_entry_says_what_the_manifest_says() {
    let (_dir, store) = store_with(&[7]);
    let entry = store.entry(&nth(7)).expect("there");
    let files: u64 = [STATE, POLICY, CONFIG, ROBOT]
        .iter()
        .map(|file| std::fs::metadata(entry.dir.join(file)).expect("there").len())
        .sum();
    assert_eq!((entry.iteration, entry.kind, entry.bytes), (7, Kind::Training, files));
    assert_eq!(entry.labels, Labels::default());
    let json = serde_json::to_value(&entry).expect("JSON");
    assert_eq!(json["name"], "iteration-00000007");
    assert_eq!(serde_json::from_value::<Entry>(json).expect("back"), entry);
    let error = store.entry(&name("other")).expect_err("absent");
    assert!(matches!(error, CheckpointError::Absent { .. }), "{error}");
}

#[test]
fn a_manifest_of_the_first_version_is_read() {
    let (_dir, store) = store_with(&[7]);
    let path = store.dir(&nth(7)).join(MANIFEST);
    let text = std::fs::read_to_string(&path).expect("read");
    assert!(!text.contains("origins"), "written only where there are some");
    assert_eq!(Manifest::read(&store.dir(&nth(7))).expect("reads").origins, []);
}

#[test]
fn only_the_runs_own_checkpoints_are_listed_and_only_with_a_state_are_they_the_latest() {
    let (_dir, store) = store_with(&[5, 50]);
    // As imported ones: one with another name, and one of the run's without a training state.
    copy(&store.dir(&nth(50)), &store.dir(&name("zebra")));
    copy(&store.dir(&nth(50)), &store.dir(&nth(60)));
    std::fs::remove_file(store.dir(&nth(60)).join(STATE)).expect("remove");
    let mut manifest = Manifest::read(&store.dir(&nth(60))).expect("reads");
    manifest.files.remove(STATE);
    std::fs::write(store.dir(&nth(60)).join(MANIFEST), manifest.to_json()).expect("write");
    // What is no checkpoint at all.
    std::fs::create_dir(store.root().join("notes")).expect("mkdir");
    std::fs::write(store.root().join("iteration-00000070"), "a file").expect("write");

    let own: Vec<_> = store.list().expect("lists");
    assert_eq!(own, [5, 50, 60].map(|iteration| store.dir(&nth(iteration))));
    let expected = ["zebra", "iteration-00000005", "iteration-00000050", "iteration-00000060"];
    assert_eq!(names(&store), expected, "the run's own last");
    assert_eq!(store.entry(&nth(60)).expect("there").kind, Kind::Policy);
    assert_eq!(store.latest().expect("whole").manifest.iteration, 50);
}

#[test]
fn a_link_is_no_checkpoint() {
    let (dir, store) = store_with(&[5]);
    let precious = dir.path().join("precious");
    copy(&store.dir(&nth(5)), &precious);
    std::os::unix::fs::symlink(&precious, store.dir(&nth(1))).expect("link");
    assert_eq!(store.list().expect("lists"), [store.dir(&nth(5))]);
    let retention = Retention { latest: 1, every: 0, best: true };
    store.retain(&retention).expect("retains");
    assert!(store.delete(&nth(1)).is_err());
    assert!(precious.join(MANIFEST).exists(), "nothing is removed through a link");

    // Nor is anything read or labelled through one.
    std::os::unix::fs::symlink(&precious, store.dir(&name("linked"))).expect("link");
    for link in [nth(1), name("linked")] {
        let absent = |outcome: Result<(), CheckpointError>| {
            let error = outcome.expect_err("a link");
            assert!(matches!(error, CheckpointError::Absent { .. }), "{error}");
        };
        absent(store.entry(&link).map(drop));
        absent(store.pin(&link, true));
        absent(store.tag(&link, "mine"));
        absent(store.record_score(&link, score(0.0)).map(drop));
        absent(store.export(&link, std::io::sink()));
        absent(store.verify(&link).map(drop));
    }
    assert!(!precious.join(LABELS).exists());
}

#[test]
fn no_file_is_read_through_a_link_and_no_pipe_is_waited_for() {
    let (dir, store) = store_with(&[5]);
    let checkpoint = store.dir(&nth(5));
    for file in [STATE, POLICY, CONFIG, ROBOT, MANIFEST] {
        let (path, elsewhere) = (checkpoint.join(file), dir.path().join(file));
        std::fs::rename(&path, &elsewhere).expect("rename");
        std::os::unix::fs::symlink(&elsewhere, &path).expect("link");
        let error = store.load(&checkpoint).expect_err(file).to_string();
        assert!(error.contains(file) && error.contains("is a symbolic link"), "{error}");
        assert!(store.export(&nth(5), std::io::sink()).is_err(), "{file}");
        std::fs::remove_file(&path).expect("remove");
        let status = std::process::Command::new("mkfifo").arg(&path).status().expect("starts");
        assert!(status.success());
        let error = store.load(&checkpoint).expect_err(file).to_string();
        assert!(error.contains("is a pipe"), "{error}");
        std::fs::remove_file(&path).expect("remove");
        std::fs::rename(&elsewhere, &path).expect("rename");
    }
    store.load(&checkpoint).expect("whole again");
}

#[test]
fn a_flipped_byte_anywhere_is_found_and_the_checkpoint_before_is_taken() {
    for file in [STATE, POLICY, CONFIG, ROBOT, MANIFEST] {
        let (_dir, store) = store_with(&[1, 2]);
        let newest = store.dir(&nth(2));
        let path = newest.join(file);
        let mut bytes = std::fs::read(&path).expect("read");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x80;
        std::fs::write(&path, bytes).expect("write");
        assert!(store.load(&newest).is_err(), "{file}");
        assert_eq!(store.latest().expect("the older one").manifest.iteration, 1, "{file}");
    }
}

#[test]
fn a_truncated_file_is_named() {
    let (_dir, store) = store_with(&[1]);
    let path = store.dir(&nth(1)).join(STATE);
    let bytes = std::fs::read(&path).expect("read");
    std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("write");
    let message = store.latest().expect_err("the only one is damaged").to_string();
    assert!(
        message.contains("state.safetensors") && message.contains("manifest says"),
        "{message}"
    );
}

#[test]
fn a_manifest_that_lists_other_files_is_refused() {
    let (_dir, store) = store_with(&[1]);
    for file in ["../../secret", "labels.json", "manifest.json"] {
        let mut manifest = Manifest::read(&store.dir(&nth(1))).expect("reads");
        let entry = manifest.files[STATE].clone();
        manifest.files.insert(file.to_owned(), entry);
        let error = Manifest::parse(&manifest.to_json()).expect_err(file);
        assert!(error.contains(file), "{error}");
    }
}

#[test]
fn an_empty_store_says_so_and_is_not_made_by_looking() {
    let (dir, store) = store();
    let error = store.latest().expect_err("empty");
    assert!(matches!(error, CheckpointError::NotFound { .. }), "{error}");
    assert_eq!(store.entries().expect("none"), []);
    store.heal_catalogue();
    assert!(contents(dir.path()).is_empty());
}

#[test]
fn the_same_iteration_twice_stays_and_another_state_replaces_it() {
    let (_dir, store) = store_with(&[5]);
    store.tag(&nth(5), "mine").expect("tags");
    commit(&store, 5);
    assert!(store.entry(&nth(5)).expect("there").labels.has_tag("mine"), "it was left alone");

    // A run whose budget was changed comes to another state; what was said of the old is void.
    let other = snapshot_of(&config(), 5, 1.0);
    for _ in 0..2 {
        commit_of(&store, &config(), &other);
        let entry = store.entry(&nth(5)).expect("there");
        assert_eq!((entry.digest, entry.labels), (other.digest, Labels::default()));
    }
    let aside: Vec<_> =
        contents(store.root()).into_iter().filter(|name| name.starts_with(".replaced-")).collect();
    assert_eq!(aside.len(), 1, "the old one is not lost: {aside:?}");
}

/// A learner refuses such a state, and the run trains its iteration again.
#[test]
fn a_state_that_is_not_what_its_manifest_says_makes_room_for_the_one_that_is() {
    let (_dir, store) = store_with(&[5]);
    store.tag(&nth(5), "mine").expect("tags");
    let dir = store.dir(&nth(5));
    let whole = std::fs::read(dir.join(STATE)).expect("read");
    let mut bytes = whole.clone();
    *bytes.last_mut().expect("not empty") ^= 1;
    std::fs::write(dir.join(STATE), &bytes).expect("write");
    let mut manifest = Manifest::read(&dir).expect("reads");
    let entry = manifest.files.get_mut(STATE).expect("listed");
    entry.blake3 = blake3::hash(&bytes).to_hex().to_string();
    std::fs::write(dir.join(MANIFEST), manifest.to_json()).expect("write");
    store.load(&dir).expect("every file is as it was committed");

    commit(&store, 5);
    assert_eq!(std::fs::read(dir.join(STATE)).expect("read"), whole);
    assert!(store.entry(&nth(5)).expect("there").labels.has_tag("mine"), "it is the same one");
    assert_eq!(store.verify(&nth(5)).expect("there").problems, [""; 0]);
}

#[test]
fn a_snapshot_that_is_not_of_its_digest_is_not_committed() {
    let (_dir, store) = store_with(&[5]);
    let mut snapshot = snapshot_of(&config(), 6, 0.0);
    *snapshot.bytes.last_mut().expect("not empty") ^= 1;
    let damaged = |snapshot: &Snapshot| {
        let robot = robot().to_toml();
        store.commit(snapshot, &config(), &robot, &serde_json::json!({})).map(drop)
    };
    let error = damaged(&snapshot).expect_err("other tensors").to_string();
    assert!(error.contains("iteration-00000006") && error.contains("holds digest"), "{error}");
    assert_eq!(store.latest().expect("the one before").manifest.iteration, 5);
    assert_eq!(contents(store.root()), ["iteration-00000005"], "nothing is left of it");
}

#[test]
fn pieces_of_a_dead_learner_do_not_mix_with_its_successors() {
    let mut assembly = Assembly::new();
    let header =
        |offset, total, iteration| SnapshotHeader { iteration, offset, total, digest: [0; 16] };
    assert_eq!(assembly.add(&header(0, 4, 1), b"ab"), Ok(None));
    // The learner died; its successor starts from the beginning.
    assert_eq!(assembly.add(&header(0, 3, 2), b"xy"), Ok(None));
    assert!(assembly.add(&header(2, 4, 1), b"cd").is_err(), "a piece of the dead one");
    assert_eq!(assembly.add(&header(0, 3, 2), b"xyz").expect("whole").expect("done").bytes, b"xyz");
}

/// Copies a checkpoint as a user would with `cp -r`.
fn copy(from: &Path, to: &Path) {
    std::fs::create_dir(to).expect("mkdir");
    for file in contents(from) {
        std::fs::copy(from.join(&file), to.join(&file)).expect("copy");
    }
}

#[test]
fn what_finds_nothing_leaves_nothing() {
    let dir = tempfile::tempdir().expect("tempdir");
    let inventory = || std::fs::read_dir(dir.path()).expect("readable").count();
    let store = CheckpointStore::new(dir.path());
    store.heal_catalogue();
    assert!(store.pin(&nth(1), true).is_err() && store.tag(&nth(1), "x").is_err());
    assert!(store.delete(&nth(1)).is_err());
    assert_eq!(store.retain(&Retention { latest: 1, every: 0, best: true }).expect("nothing"), []);
    assert!(store.import(&b"no archive"[..], None).is_err());
    assert_eq!(inventory(), 0);
    let deep = CheckpointStore::new(dir.path().join("a/b"));
    assert!(deep.import(&b"no archive"[..], None).is_err());
    assert_eq!(inventory(), 0);
    // What was there before stays.
    std::fs::write(dir.path().join("notes"), "mine").expect("write");
    assert!(store.import(&b"no archive"[..], None).is_err());
    assert!(dir.path().join("notes").exists());
}

#[test]
fn a_state_tells_the_precision_that_an_earlier_version_left_undecided() {
    let (_dir, store) = store_with(&[7]);
    let mut checkpoint = store.load(&store.dir(&nth(7))).expect("whole");
    for known in [Precision::F32, Precision::Bf16] {
        checkpoint.config.run.precision = known;
        assert_eq!(checkpoint.precision().ok(), Some(known));
    }
    checkpoint.config.run.precision = Precision::Auto;
    let other = TensorView::new(Dtype::U64, vec![1], &[0; 8]).expect("sized");
    let file = safetensors::serialize([("counters.iteration", other)], None).expect("a file");
    std::fs::write(checkpoint.state(), file).expect("writable");
    let error = checkpoint.precision().expect_err("nothing tells").to_string();
    assert!(error.contains("state.safetensors") && error.contains("counters.precision"), "{error}");
    // Bits of the products' operands, as the learner writes them.
    for (bits, expected) in
        [(16_u64, Some(Precision::Bf16)), (32, Some(Precision::F32)), (8, None), (1 << 40, None)]
    {
        let bytes = bits.to_le_bytes();
        let view = TensorView::new(Dtype::U64, vec![1], &bytes).expect("sized");
        let file = safetensors::serialize([("counters.precision", view)], None).expect("a file");
        std::fs::write(checkpoint.state(), file).expect("writable");
        assert_eq!(checkpoint.precision().ok(), expected, "{bits}");
    }
}
