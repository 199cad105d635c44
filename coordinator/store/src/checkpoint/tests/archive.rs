use tar::{Builder, EntryType, Header};

use super::*;

/// An archive of these entries: path, type, content.
fn tar_of(entries: &[(&str, EntryType, &[u8])]) -> Vec<u8> {
    let mut builder = Builder::new(Vec::new());
    for (path, kind, content) in entries {
        let mut header = Header::new_ustar();
        // Written past the checks of `set_path`, as an attacker would.
        header.as_mut_bytes()[..path.len()].copy_from_slice(path.as_bytes());
        header.set_entry_type(*kind);
        header.set_size(content.len() as u64);
        header.set_mode(0o644);
        header.set_cksum();
        builder.append(&header, *content).expect("in memory");
    }
    builder.into_inner().expect("in memory")
}

/// The files of a checkpoint, manifest first.
fn files_of(dir: &Path) -> Vec<(String, Vec<u8>)> {
    [MANIFEST, CONFIG, POLICY, ROBOT, STATE]
        .map(|file| (file.to_owned(), std::fs::read(dir.join(file)).expect("read")))
        .into()
}

fn pack(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    pack_into("x", files)
}

fn pack_into(folder: &str, files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let paths: Vec<String> = files.iter().map(|(file, _)| format!("{folder}/{file}")).collect();
    let entries: Vec<_> = paths
        .iter()
        .zip(files)
        .map(|(path, (_, content))| (path.as_str(), EntryType::Regular, content.as_slice()))
        .collect();
    tar_of(&entries)
}

#[test]
fn a_checkpoint_goes_through_an_archive_unchanged() {
    let (_dir, store) = store_with(&[7]);
    store.pin(&nth(7), true).expect("pins");
    let bytes = packed(&store, &nth(7));
    assert_eq!(bytes, packed(&store, &nth(7)), "the same bytes each time");

    let mut archive = tar::Archive::new(&bytes[..]);
    let listed: Vec<_> = archive
        .entries()
        .expect("an archive")
        .map(|entry| {
            let entry = entry.expect("an entry");
            let header = entry.header();
            assert_eq!((header.mode().expect("mode"), header.mtime().expect("time")), (0o644, 0));
            entry.path().expect("a path").display().to_string()
        })
        .collect();
    let files = ["manifest.json", "config.toml", "policy.safetensors", "robot.toml"];
    let expected: Vec<_> = files
        .iter()
        .chain(&["state.safetensors"])
        .map(|file| format!("iteration-00000007/{file}"))
        .collect();
    assert_eq!(listed, expected);

    let (_other_dir, other) = super::store();
    let entry = other.import(&bytes[..], None).expect("imports");
    let expected = Labels { imported: true, ..Labels::default() };
    assert_eq!((entry.name, entry.labels), (nth(7), expected), "labels do not travel");
    assert_eq!(files_of(&other.dir(&nth(7))), files_of(&store.dir(&nth(7))));
    assert!(other.verify(&nth(7)).expect("there").is_whole());
    assert_eq!(other.latest().expect("a training state").manifest.iteration, 7);
    assert_eq!(packed(&other, &nth(7)), bytes);
}

#[test]
fn the_longest_name_fits_into_an_archive() {
    let (_dir, store) = store_with(&[7]);
    let longest = name(&"n".repeat(100));
    let bytes = packed(&store, &nth(7));
    store.import(&bytes[..], Some(longest.clone())).expect("imports");
    let bytes = packed(&store, &longest);
    let (_other_dir, other) = super::store();
    assert_eq!(other.import(&bytes[..], None).expect("imports").name, longest);
}

#[test]
fn a_name_that_is_taken() {
    let (_dir, store) = store_with(&[1, 2]);
    let one = packed(&store, &nth(1));
    let two = packed(&store, &nth(2));
    store.import(&one[..], Some(name("x"))).expect("imports");
    store.tag(&name("x"), "mine").expect("tags");
    let again = store.import(&one[..], Some(name("x"))).expect("the same again");
    assert!(again.labels.has_tag("mine"), "it was left alone");
    let error = store.import(&two[..], Some(name("x"))).expect_err("another");
    assert!(matches!(error, CheckpointError::Conflict { .. }), "{error}");
    assert!(error.to_string().contains("choose another name"), "{error}");

    // A damaged one is mended, and keeps what its users said of it.
    std::fs::write(store.dir(&name("x")).join(STATE), "damaged").expect("write");
    let mended = store.import(&one[..], Some(name("x"))).expect("mends");
    assert!(mended.labels.has_tag("mine") && store.verify(&name("x")).expect("there").is_whole());
}

#[test]
fn what_resume_would_take_up_must_be_of_the_run() {
    let (_dir, store) = store_with(&[1]);
    let (_other_dir, other) = super::store();
    let foreign = config_with(&["run.seed=99"]);
    commit_of(&other, &foreign, &snapshot_of(&foreign, 5, 0.0));
    let bytes = packed(&other, &nth(5));
    let error = store.import(&bytes[..], None).expect_err("another run's").to_string();
    assert!(error.contains("of another run") && error.contains("another name"), "{error}");
    let error = store.import(&bytes[..], Some(nth(6))).expect_err("iteration 5").to_string();
    assert!(error.contains("iteration 5"), "{error}");
    store.import(&bytes[..], Some(name("foreign"))).expect("under another name");
    assert_eq!(store.latest().expect("its own").manifest.iteration, 1);

    // The run's own later checkpoint, with a larger budget, comes back.
    let longer = config_with(&["run.env_steps=1000000000"]);
    commit_of(&other, &longer, &snapshot_of(&longer, 9, 0.0));
    let bytes = packed(&other, &nth(9));
    store.import(&bytes[..], None).expect("its own");
    assert_eq!(store.latest().expect("its own").manifest.iteration, 9);
}

#[test]
fn what_resume_would_take_up_is_compared_with_the_run_itself() {
    let (dir, store) = super::store();
    let (_other_dir, other) = super::store();
    let foreign = config_with(&["run.seed=99"]);
    commit_of(&other, &foreign, &snapshot_of(&foreign, 5, 0.0));
    let bytes = packed(&other, &nth(5));
    // A run that has no checkpoint yet.
    std::fs::write(dir.path().join(CONFIG), config().to_toml()).expect("write");
    std::fs::write(dir.path().join(ROBOT), robot().to_toml()).expect("write");
    let error = store.import(&bytes[..], None).expect_err("another run's").to_string();
    assert!(error.contains("of another run") && error.contains("another name"), "{error}");
    let robot_of_another = robot().to_toml().replacen("name = ", "# other\nname = ", 1);
    std::fs::write(dir.path().join(CONFIG), foreign.to_toml()).expect("write");
    std::fs::write(dir.path().join(ROBOT), robot_of_another).expect("write");
    let error = store.import(&bytes[..], None).expect_err("another robot").to_string();
    assert!(error.contains("of another run"), "{error}");
    std::fs::write(dir.path().join(ROBOT), robot().to_toml()).expect("write");
    store.import(&bytes[..], None).expect("the run's own");

    // A run that cannot say what it is.
    store.delete_even_newest(&nth(5)).expect("removes");
    std::fs::write(dir.path().join(CONFIG), "[run").expect("write");
    assert!(store.import(&bytes[..], None).is_err());
    assert!(contents(store.root()).is_empty());
}

#[test]
fn a_name_that_means_something_else_is_given_to_no_checkpoint() {
    let (_dir, store) = store_with(&[1]);
    store.tag(&nth(1), "mine").expect("tags");
    let bytes = packed(&store, &nth(1));
    let files = files_of(&store.dir(&nth(1)));
    let before = contents(store.root());
    for (reserved, word) in [
        ("best", "always selects"),
        ("latest", "always selects"),
        ("promoted", "always selects"),
        ("0", "look like an iteration"),
        ("0017", "look like an iteration"),
        ("catalogue.sqlite", "catalogue"),
        ("catalogue.sqlite-wal", "catalogue"),
        ("mine", "is a tag of iteration-00000001"),
    ] {
        let given = store.import(&bytes[..], Some(name(reserved)));
        let inside = store.import(&pack_into(reserved, &files)[..], None);
        for error in [given, inside].map(|outcome| outcome.expect_err(reserved).to_string()) {
            assert!(error.contains(word) && error.contains("choose another"), "{error}");
        }
        assert_eq!(contents(store.root()), before, "{reserved}");
    }
    store.untag(&nth(1), "mine").expect("untags");
    store.import(&bytes[..], Some(name("mine"))).expect("free now");
    let error = store.tag(&nth(1), "mine").expect_err("a name").to_string();
    assert!(error.contains("name of a checkpoint"), "{error}");
    // One whose manifest is damaged has its name still.
    std::fs::write(store.dir(&name("mine")).join(MANIFEST), "{}").expect("write");
    assert!(store.tag(&nth(1), "mine").is_err());
}

#[test]
fn a_directory_that_is_no_checkpoint_is_left_alone() {
    let (_dir, store) = store_with(&[1]);
    let notes = store.root().join("notes");
    std::fs::create_dir(&notes).expect("mkdir");
    std::fs::write(notes.join("ideas"), "precious").expect("write");
    let error = store.import(&packed(&store, &nth(1))[..], Some(name("notes")));
    let error = error.expect_err("somebody's directory").to_string();
    assert!(error.contains("no checkpoint") && error.contains("another name"), "{error}");
    assert_eq!(contents(store.root()), ["iteration-00000001", "notes"]);
}

#[test]
fn a_damaged_checkpoint_is_not_exported() {
    let (_dir, store) = store_with(&[1]);
    std::fs::write(store.dir(&nth(1)).join(POLICY), "damaged").expect("write");
    let mut bytes = Vec::new();
    assert!(store.export(&nth(1), &mut bytes).is_err());
    assert!(bytes.is_empty());
    assert!(matches!(store.export(&nth(2), &mut bytes), Err(CheckpointError::Absent { .. })));
}

#[test]
fn an_archive_cut_anywhere_is_refused_and_leaves_nothing() {
    let (_dir, store) = store_with(&[1]);
    let bytes = packed(&store, &nth(1));
    let (_other_dir, other) = super::store();
    // The two last blocks only say that the archive ends.
    let end = bytes.len() - 1024;
    for cut in (0..end).step_by(509).chain([end - 1]) {
        assert!(other.import(&bytes[..cut], None).is_err(), "cut at {cut} of {}", bytes.len());
    }
    assert!(contents(other.root()).is_empty(), "{:?}", contents(other.root()));
}

#[test]
fn a_flipped_byte_anywhere_is_refused() {
    let (_dir, store) = store_with(&[1]);
    let whole = packed(&store, &nth(1));
    let (_other_dir, other) = super::store();
    let mut archive = tar::Archive::new(&whole[..]);
    let mut meaningful = Vec::new();
    for entry in archive.entries().expect("an archive") {
        let entry = entry.expect("an entry");
        let start = entry.raw_file_position() as usize;
        // The manifest's own remarks are nobody's to confirm; of the others every byte is hashed.
        if !entry.path().expect("a path").ends_with(MANIFEST) {
            meaningful.push(start..start + entry.size() as usize);
        }
    }
    let mut bytes = whole.clone();
    for position in meaningful.into_iter().flat_map(|range| range.step_by(997)) {
        bytes[position] ^= 1 << (position % 8);
        assert!(other.import(&bytes[..], None).is_err(), "at {position}");
        bytes[position] = whole[position];
    }
    assert!(contents(other.root()).is_empty());
    other.import(&bytes[..], None).expect("whole again");
}

#[test]
fn hostile_archives_are_refused_before_they_do_anything() {
    let (dir, store) = store_with(&[1]);
    let files = files_of(&store.dir(&nth(1)));
    let manifest = files[0].1.as_slice();
    let state = files[4].1.as_slice();
    let regular = EntryType::Regular;
    let long = format!("{}/manifest.json", "n".repeat(101));
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        ("no bytes", Vec::new(), "empty"),
        ("no archive", vec![7; 3000], "cannot be read"),
        ("empty archive", vec![0; 1024], "empty"),
        ("absolute", tar_of(&[("/etc/manifest.json", regular, manifest)]), "NAME/FILE"),
        ("parent", tar_of(&[("../manifest.json", regular, manifest)]), "NAME/FILE"),
        ("parent within", tar_of(&[("x/../manifest.json", regular, manifest)]), "NAME/FILE"),
        ("too deep", tar_of(&[("x/y/manifest.json", regular, manifest)]), "NAME/FILE"),
        ("no folder", tar_of(&[("manifest.json", regular, manifest)]), "NAME/FILE"),
        ("hidden", tar_of(&[(".x/manifest.json", regular, manifest)]), "NAME/FILE"),
        ("long name", tar_of(&[(&long, regular, manifest)]), "NAME/FILE"),
        ("other file", tar_of(&[("x/labels.json", regular, b"{}")]), "NAME/FILE"),
        ("directory", tar_of(&[("x/", EntryType::Directory, b"")]), "no regular file"),
        ("link", tar_of(&[("x/manifest.json", EntryType::Symlink, b"")]), "no regular file"),
        ("hard link", tar_of(&[("x/manifest.json", EntryType::Link, b"")]), "no regular file"),
        ("device", tar_of(&[("x/manifest.json", EntryType::Char, b"")]), "no regular file"),
        ("sparse", tar_of(&[("x/manifest.json", EntryType::GNUSparse, b"")]), "no regular file"),
        ("extension", tar_of(&[("x/a", EntryType::XHeader, b"9 a=b\n")]), "no regular file"),
        ("long link", tar_of(&[("x/a", EntryType::GNULongName, b"y/z\0")]), "no regular file"),
        ("manifest last", tar_of(&[("x/state.safetensors", regular, state)]), "begins with"),
        ("no manifest", tar_of(&[("x/manifest.json", regular, b"{}")]), "not a manifest"),
        (
            "large manifest",
            tar_of(&[("x/manifest.json", regular, &vec![b' '; 2 << 20])]),
            "more than",
        ),
        (
            "two folders",
            tar_of(&[
                ("x/manifest.json", regular, manifest),
                ("y/state.safetensors", regular, state),
            ]),
            "two folders",
        ),
        (
            "second manifest",
            tar_of(&[
                ("x/manifest.json", regular, manifest),
                ("x/manifest.json", regular, manifest),
            ]),
            "or there twice",
        ),
        (
            "other length",
            tar_of(&[("x/manifest.json", regular, manifest), ("x/config.toml", regular, b"x")]),
            "1 bytes",
        ),
        ("a file too few", pack(&files[..4]), "state.safetensors is missing"),
        ("a file twice", pack(&[&files[..], &files[4..]].concat()), "twice"),
    ];
    let (_other_dir, other) = super::store();
    for (what, bytes, word) in cases {
        let error = other.import(&bytes[..], None).expect_err(what);
        assert!(matches!(error, CheckpointError::Archive { .. }), "{what}: {error}");
        assert!(error.to_string().contains(word), "{what}: `{word}` is not in: {error}");
        assert!(contents(other.root()).is_empty(), "{what}");
    }
    assert_eq!(contents(dir.path()), ["checkpoints"]);
}

#[test]
fn a_manifest_that_announces_too_much_is_refused_at_once() {
    let (_dir, store) = store_with(&[1]);
    let mut manifest = Manifest::read(&store.dir(&nth(1))).expect("reads");
    let (_other_dir, other) = super::store();
    for (file, len, word) in [
        (STATE, MAX_CONTENT, "announces"),
        (STATE, u64::MAX, "announces"),
        (CONFIG, 2 << 20, "config.toml has"),
        (ROBOT, 2 << 20, "robot.toml has"),
    ] {
        let before = manifest.files[file].len;
        manifest.files.get_mut(file).expect("listed").len = len;
        let bytes = pack(&[(MANIFEST.to_owned(), manifest.to_json())]);
        let error = other.import(&bytes[..], None).expect_err(file).to_string();
        assert!(error.contains(word), "{error}");
        manifest.files.get_mut(file).expect("listed").len = before;
    }
}

#[test]
fn an_archive_whose_parts_make_no_sense_is_refused() {
    let (_dir, store) = store_with(&[1]);
    let (_other_dir, other) = super::store();
    for (file, content) in
        [(STATE, &b"no tensors"[..]), (POLICY, b"{}"), (CONFIG, b"[task"), (ROBOT, b"name = 1")]
    {
        let mut files = files_of(&store.dir(&nth(1)));
        let mut manifest = Manifest::parse(&files[0].1).expect("reads");
        let blake3 = blake3::hash(content).to_hex().to_string();
        let entry = FileEntry { len: content.len() as u64, blake3 };
        manifest.files.insert(file.to_owned(), entry);
        files[0].1 = manifest.to_json();
        files.iter_mut().find(|(name, _)| name == file).expect("there").1 = content.to_vec();
        let error = other.import(&pack(&files)[..], None).expect_err(file).to_string();
        assert!(error.contains(file), "{file}: {error}");
        assert!(contents(other.root()).is_empty(), "{file}");
    }
}

/// Only the seed was compared once: a run could take up a state that it cannot go on from.
#[test]
fn keys_of_the_run_that_change_what_is_learned_make_another_run() {
    let overlap = 1 - config().run.overlap;
    for (key, taken_up) in [
        (format!("run.overlap={overlap}"), false),
        ("run.learner_threads=7".to_owned(), false),
        ("run.workers=7".to_owned(), true),
        ("run.env_steps=9e9".to_owned(), true),
    ] {
        let (_dir, store) = store_with(&[1]);
        let (_other_dir, other) = super::store();
        let changed = config_with(&[&key]);
        commit_of(&other, &changed, &snapshot_of(&changed, 5, 0.0));
        let imported = store.import(&packed(&other, &nth(5))[..], None);
        assert_eq!(imported.is_ok(), taken_up, "{key}: {imported:?}");
    }
}
