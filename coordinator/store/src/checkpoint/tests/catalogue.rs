use rusqlite::Connection;

use super::*;

/// What a user's tool reads: name, pinned, score, tags of every checkpoint.
fn rows(store: &CheckpointStore) -> Vec<String> {
    let database = Connection::open(store.root().join(CATALOGUE)).expect("opens");
    let mut statement = database
        .prepare(
            "select c.name || ' ' || c.pinned || ' ' || coalesce(c.score, '-') || ' ' ||
             coalesce((select group_concat(tag) from tags t where t.name = c.name), '-')
             from checkpoints c order by c.name",
        )
        .expect("the documented tables");
    let rows = statement.query_map([], |row| row.get(0)).expect("runs");
    rows.collect::<Result<_, _>>().expect("reads")
}

#[test]
fn it_follows_every_change() {
    let (_dir, store) = store_with(&[1, 2]);
    assert_eq!(rows(&store), ["iteration-00000001 0 - -", "iteration-00000002 0 - -"]);
    store.pin(&nth(1), true).expect("pins");
    store.tag(&nth(2), "mine").expect("tags");
    store.record_score(&nth(2), score(0.25)).expect("scores");
    let expected = ["iteration-00000001 1 - -", "iteration-00000002 0 0.25 best,mine"];
    assert_eq!(rows(&store), expected);
    store.untag(&nth(2), "mine").expect("untags");
    store.delete(&nth(2)).expect("removes");
    assert_eq!(rows(&store), ["iteration-00000001 1 - -"]);
    let bytes = packed(&store, &nth(1));
    store.import(&bytes[..], Some(name("foreign"))).expect("imports");
    assert_eq!(rows(&store), ["foreign 0 - -", "iteration-00000001 1 - -"]);
}

#[test]
fn missing_damaged_old_or_wrong_it_is_rebuilt() {
    let (_dir, store) = store_with(&[1, 2]);
    let path = store.root().join(CATALOGUE);
    let truth = rows(&store);
    let sql = |text: &str| {
        Connection::open(&path).expect("opens").execute_batch(text).expect("runs");
    };
    let damages: [(&str, &dyn Fn()); 8] = [
        ("missing", &|| std::fs::remove_file(&path).expect("remove")),
        ("empty", &|| std::fs::write(&path, "").expect("write")),
        ("no database", &|| std::fs::write(&path, "x".repeat(5000)).expect("write")),
        ("torn", &|| {
            let bytes = std::fs::read(&path).expect("read");
            std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("write");
        }),
        ("overwritten", &|| {
            let mut bytes = std::fs::read(&path).expect("read");
            bytes[4096..].fill(0xa5);
            std::fs::write(&path, bytes).expect("write");
        }),
        ("of another version", &|| sql("pragma user_version = 99")),
        ("without a table", &|| sql("drop table tags")),
        ("wrong", &|| sql("delete from checkpoints where iteration = 1")),
    ];
    for (what, damage) in damages {
        damage();
        store.heal_catalogue();
        assert_eq!(rows(&store), truth, "{what}, healed");
        damage();
        // A change of something else sets it right too.
        store.pin(&nth(2), true).expect(what);
        store.pin(&nth(2), false).expect(what);
        assert_eq!(rows(&store), truth, "{what}, by the way");
        damage();
        assert_eq!(store.rebuild().expect("rebuilds"), 2, "{what}");
        assert_eq!(rows(&store), truth, "{what}, rebuilt");
    }
}

#[test]
fn a_directory_removed_or_copied_by_hand_is_noticed() {
    let (_dir, store) = store_with(&[1, 2]);
    std::fs::remove_dir_all(store.dir(&nth(1))).expect("remove");
    store.heal_catalogue();
    assert_eq!(rows(&store), ["iteration-00000002 0 - -"]);
    std::fs::rename(store.dir(&nth(2)), store.dir(&name("kept"))).expect("rename");
    commit(&store, 3);
    assert_eq!(rows(&store), ["iteration-00000003 0 - -", "kept 0 - -"]);
}

#[test]
fn a_catalogue_that_cannot_be_written_fails_no_commit() {
    let (_dir, store) = store();
    std::fs::create_dir_all(store.root().join(CATALOGUE)).expect("a directory in its place");
    commit(&store, 1);
    store.pin(&nth(1), true).expect("pins");
    assert!(store.entry(&nth(1)).expect("there").labels.pinned);
    assert!(store.rebuild().is_err(), "asked for, it is an error");
}

#[test]
fn a_reader_in_a_transaction_stops_nobody() {
    let (_dir, store) = store_with(&[1]);
    let reader = Connection::open(store.root().join(CATALOGUE)).expect("opens");
    reader.execute_batch("begin; select * from checkpoints;").expect("reads");
    commit(&store, 2);
    drop(reader);
    assert_eq!(rows(&store).len(), 2);
}
