use std::path::PathBuf;

use super::*;

/// A run directory with a store.
fn run() -> (TempDir, PathBuf, CheckpointStore) {
    let dir = tempfile::tempdir().expect("tempdir");
    let run = dir.path().join("run");
    std::fs::create_dir(&run).expect("mkdir");
    std::fs::write(run.join(CONFIG), config().to_toml()).expect("write");
    let store = CheckpointStore::new(run.join("checkpoints"));
    for iteration in [1, 2, 30] {
        commit(&store, iteration);
    }
    (dir, run, store)
}

fn located(text: &str) -> Result<String, String> {
    let selector: Selector = text.parse()?;
    let (_, name) = selector.locate().map_err(|error| error.to_string())?;
    let opened = selector.open().map_err(|error| error.to_string())?;
    assert!(opened.dir.ends_with(&name), "{} for {name}", opened.dir.display());
    Ok(name.to_string())
}

#[test]
fn every_way_to_name_a_checkpoint() {
    let (_dir, run, store) = run();
    store.tag(&nth(2), "stable").expect("tags");
    store.record_score(&nth(1), score(0.1)).expect("scores");
    let bytes = packed(&store, &nth(2));
    store.import(&bytes[..], Some(name("foreign"))).expect("imports");
    let run = run.display();
    let newest = "iteration-00000030";
    for (text, expected) in [
        (format!("{run}"), newest),
        (format!("{run}/"), newest),
        (format!("{run}/checkpoints"), newest),
        (format!("{run}:latest"), newest),
        (format!("{run}:best"), "iteration-00000001"),
        (format!("{run}:2"), "iteration-00000002"),
        (format!("{run}:002"), "iteration-00000002"),
        (format!("{run}:stable"), "iteration-00000002"),
        (format!("{run}:iteration-00000002"), "iteration-00000002"),
        (format!("{run}:foreign"), "foreign"),
        (format!("{run}/checkpoints:2"), "iteration-00000002"),
        (format!("{run}/checkpoints/iteration-00000002"), "iteration-00000002"),
        (format!("{run}/checkpoints/foreign/"), "foreign"),
        (format!("{run}/checkpoints/foreign/../iteration-00000002/."), "iteration-00000002"),
    ] {
        assert_eq!(located(&text).as_deref(), Ok(expected), "{text}");
    }
}

#[test]
fn errors_say_what_there_is() {
    let (dir, run, store) = run();
    store.tag(&nth(2), "stable").expect("tags");
    let at = run.display();
    let none = dir.path().join("none").display().to_string();
    let empty = dir.path().join("empty");
    std::fs::create_dir(&empty).expect("mkdir");
    let empty = empty.display();
    for (text, words) in [
        (format!("{at}:7"), &["no checkpoint of iteration 7", "iteration-00000030"][..]),
        (format!("{at}:nope"), &["no tag `nope`", "iteration-00000002 (stable)"]),
        (format!("{at}:best"), &["no checkpoint with a score", "iteration-00000030"]),
        (format!("{at}:"), &["cannot be a name", "empty"]),
        (format!("{at}:../x"), &["cannot be a name"]),
        (none.clone(), &["does not exist", "octopus status"]),
        (format!("{none}:best"), &["none", "does not exist"]),
        (format!("{empty}"), &["holds no checkpoint"]),
        (format!("{empty}:best"), &["no other either"]),
        (format!("{at}/config.toml"), &["is no directory"]),
        (":best".to_owned(), &["names no run"]),
        (String::new(), &["RUN:NAME"]),
    ] {
        let error = located(&text).expect_err(&text);
        for word in words {
            assert!(error.contains(word), "{text}: `{word}` is not in: {error}");
        }
    }
}

#[test]
fn a_path_with_a_colon_that_exists_wins() {
    let (dir, run, _store) = run();
    let odd = dir.path().join("run:best");
    std::fs::rename(&run, &odd).expect("rename");
    assert_eq!(located(&odd.display().to_string()).as_deref(), Ok("iteration-00000030"));
    assert_eq!(located(&format!("{}:2", odd.display())).as_deref(), Ok("iteration-00000002"));
}

#[test]
fn a_damaged_checkpoint_is_named_not_skipped_when_it_was_asked_for() {
    let (_dir, run, store) = run();
    std::fs::write(store.dir(&nth(30)).join(STATE), "damaged").expect("write");
    let at = run.display();
    let error = |text: String| {
        text.parse::<Selector>().expect("parses").open().expect_err(&text).to_string()
    };
    assert!(error(format!("{at}:30")).contains(STATE));
    assert!(error(format!("{at}/checkpoints/iteration-00000030")).contains(STATE));
    let latest = format!("{at}:latest").parse::<Selector>().expect("parses").open();
    assert_eq!(latest.expect("the one before").manifest.iteration, 2);

    // Without its manifest the directory still means that checkpoint, not a run.
    std::fs::remove_file(store.dir(&nth(30)).join(MANIFEST)).expect("remove");
    assert!(error(format!("{at}/checkpoints/iteration-00000030")).contains(MANIFEST));
    let selector: Selector =
        format!("{at}/checkpoints/iteration-00000030").parse().expect("parses");
    assert!(selector.is_explicit());
    assert_eq!(selector.locate().expect("located").1, nth(30));
}

#[test]
fn a_tag_on_two_is_told_apart_by_the_user() {
    let (_dir, run, store) = run();
    store.tag(&nth(1), "mine").expect("tags");
    let labels = store.dir(&nth(1)).join(LABELS);
    std::fs::copy(labels, store.dir(&nth(2)).join(LABELS)).expect("as a kill leaves it");
    let text = format!("{}:mine", run.display());
    assert!(located(&text).expect_err("two").contains("tag one of them again"));
    store.tag(&nth(2), "mine").expect("tags");
    assert_eq!(located(&text).as_deref(), Ok("iteration-00000002"));
}

#[test]
fn a_link_from_elsewhere_is_the_checkpoint_that_it_leads_to() {
    let (dir, store) = store_with(&[5]);
    let link = dir.path().join("favourite");
    std::os::unix::fs::symlink(store.dir(&nth(5)), &link).expect("link");
    let (found, found_name) = Selector::from_path(&link).expect("a path").locate().expect("there");
    assert_eq!(found_name, nth(5));
    found.pin(&found_name, true).expect("pins");
    assert!(store.entry(&nth(5)).expect("there").labels.pinned);
}

#[test]
fn a_copy_whose_directory_has_a_name_that_is_none_says_so() {
    let (dir, store) = store_with(&[5]);
    let copy = dir.path().join("my policy");
    std::fs::rename(store.dir(&nth(5)), &copy).expect("renames");
    let error = located(&copy.display().to_string()).expect_err("no name");
    assert!(error.contains("has to be renamed") && error.contains("holds ' '"), "{error}");
}

#[test]
fn a_checkpoint_is_no_store() {
    let (_dir, store) = store_with(&[5]);
    let checkpoint = store.dir(&nth(5));
    for error in [store_at(&checkpoint), store_to_be(&checkpoint)] {
        let error = error.expect_err("a checkpoint").to_string();
        assert!(error.contains("is a checkpoint") && error.contains("show"), "{error}");
    }
}
