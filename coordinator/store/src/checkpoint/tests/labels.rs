use super::*;

fn labels(store: &CheckpointStore, iteration: u64) -> Labels {
    store.entry(&nth(iteration)).expect("there").labels
}

/// Who has the tag.
fn holders(store: &CheckpointStore, tag: &str) -> Vec<String> {
    let entries = store.entries().expect("readable").into_iter();
    entries.filter(|entry| entry.labels.has_tag(tag)).map(|entry| entry.name.to_string()).collect()
}

#[test]
fn pins_tags_and_milestones_come_back_and_change_nothing_else() {
    let (_dir, store) = store_with(&[1, 2]);
    let before = std::fs::read(store.dir(&nth(1)).join(MANIFEST)).expect("read");
    store.pin(&nth(1), true).expect("pins");
    store.set_milestone(&nth(1), true).expect("marks");
    store.tag(&nth(1), "b").expect("tags");
    store.tag(&nth(1), "a").expect("tags");
    store.tag(&nth(1), "a").expect("twice is no error");
    let found = labels(&store, 1);
    assert!(found.pinned && found.milestone && found.score.is_none());
    assert_eq!(found.tags, [name("a"), name("b")]);
    store.pin(&nth(1), false).expect("unpins");
    store.untag(&nth(1), "b").expect("untags");
    let found = labels(&store, 1);
    assert!(!found.pinned && found.milestone);
    assert_eq!(found.tags, [name("a")]);
    assert_eq!(labels(&store, 2), Labels::default());
    assert_eq!(std::fs::read(store.dir(&nth(1)).join(MANIFEST)).expect("read"), before);
    assert!(store.verify(&nth(1)).expect("there").is_whole());
}

#[test]
fn a_tag_moves() {
    let (_dir, store) = store_with(&[1, 2]);
    store.tag(&nth(1), "stable").expect("tags");
    store.tag(&nth(2), "stable").expect("tags");
    assert_eq!(holders(&store, "stable"), ["iteration-00000002"]);
}

#[test]
fn what_cannot_be_a_tag_is_refused() {
    let (_dir, store) = store_with(&[1]);
    for (tag, word) in [
        ("best", "by itself"),
        ("latest", "by itself"),
        ("50", "iteration"),
        ("iteration-00000001", "name of a checkpoint"),
        ("a/b", "letters"),
        ("", "empty"),
    ] {
        let error = store.tag(&nth(1), tag).expect_err(tag).to_string();
        assert!(error.contains(word), "{tag}: {error}");
    }
    assert!(store.untag(&nth(1), "absent").is_err());
    assert!(store.untag(&nth(1), "best").is_err());
    assert!(store.pin(&nth(9), true).is_err(), "there is no such checkpoint");
    for index in 0..MAX_TAGS {
        store.tag(&nth(1), &format!("t{index}")).expect("room");
    }
    let error = store.tag(&nth(1), "one-more").expect_err("full").to_string();
    assert!(error.contains("32 tags"), "{error}");
}

#[test]
fn best_follows_the_lowest_score_of_the_runs_own() {
    let (_dir, store) = store_with(&[1, 2, 3]);
    assert!(store.best().expect("reads").is_none());
    assert!(store.record_score(&nth(2), score(0.5)).expect("scores"), "the first is the best");
    assert!(!store.record_score(&nth(1), score(0.7)).expect("scores"));
    assert_eq!(holders(&store, BEST), ["iteration-00000002"]);
    assert!(!store.record_score(&nth(3), score(0.5)).expect("scores"), "the earlier stays");
    assert!(store.record_score(&nth(3), score(0.4)).expect("scores"));
    assert_eq!(holders(&store, BEST), ["iteration-00000003"]);
    assert_eq!(store.best().expect("reads").expect("scored").labels.score, Some(score(0.4)));

    // Measured again and found worse, or gone: the next best takes over.
    assert!(!store.record_score(&nth(3), score(0.9)).expect("scores"));
    assert_eq!(holders(&store, BEST), ["iteration-00000002"]);
    store.delete(&nth(2)).expect("removes");
    assert_eq!(holders(&store, BEST), ["iteration-00000001"]);

    // An imported one can be scored, but is not the run's best.
    let bytes = packed(&store, &nth(1));
    store.import(&bytes[..], Some(name("foreign"))).expect("imports");
    assert!(!store.record_score(&name("foreign"), score(0.0)).expect("scores"));
    assert_eq!(holders(&store, BEST), ["iteration-00000001"]);
}

#[test]
fn a_score_that_json_cannot_hold_is_refused() {
    let (_dir, store) = store_with(&[1]);
    for value in [f64::NAN, f64::INFINITY] {
        assert!(store.record_score(&nth(1), score(value)).is_err());
        let errors = BTreeMap::from([("base".to_owned(), value)]);
        assert!(store.record_score(&nth(1), Score { errors, ..score(1.0) }).is_err());
    }
    assert_eq!(labels(&store, 1), Labels::default());
}

#[test]
fn damaged_labels_count_as_pinned_until_they_are_written_again() {
    let (_dir, store) = store_with(&[1, 2]);
    for damage in ["", "{", "{\"pinned\": 3}", "{\"surprise\": 1}", "[]"] {
        std::fs::write(store.dir(&nth(1)).join(LABELS), damage).expect("write");
        assert!(labels(&store, 1).pinned, "{damage}");
        let error = store.delete(&nth(1)).expect_err("pinned").to_string();
        assert!(error.contains("checkpoints unpin"), "{error}");
        let retention = Retention { latest: 1, every: 0, best: true };
        assert_eq!(store.retain(&retention).expect("retains"), [], "{damage}");
        assert_eq!(
            store.load(&store.dir(&nth(1))).expect("the rest is whole").manifest.iteration,
            1
        );
    }
    store.pin(&nth(1), false).expect("unpins");
    assert_eq!(Labels::try_read(&store.dir(&nth(1))).expect("whole again"), Labels::default());
    store.delete(&nth(1)).expect("removes");
}
