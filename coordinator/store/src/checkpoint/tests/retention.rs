use super::*;

const fn keep(latest: usize, every: u64, best: bool) -> Retention {
    Retention { latest, every, best }
}

fn iterations(store: &CheckpointStore) -> Vec<u64> {
    let entries = store.entries().expect("readable").into_iter();
    entries.filter_map(|entry| entry.name.iteration()).collect()
}

#[test]
fn the_newest_stay_and_killed_commits_are_swept() {
    let (_dir, store) = store_with(&[100, 3, 20]);
    for left in [".writing-iteration-00000200", ".removed-iteration-00000001-5"] {
        std::fs::create_dir(store.root().join(left)).expect("mkdir");
        std::fs::write(store.root().join(left).join(STATE), "a part").expect("write");
    }
    std::fs::write(store.dir(&nth(20)).join(".labels.json.77.tmp"), "{").expect("write");
    assert_eq!(store.retain(&keep(2, 0, true)).expect("retains"), [nth(3)]);
    assert_eq!(contents(store.root()), ["iteration-00000020", "iteration-00000100"]);
    assert!(!contents(&store.dir(&nth(20))).iter().any(|file| file.contains("tmp")));
}

#[test]
fn a_commit_under_way_is_not_swept() {
    let (_dir, store) = store_with(&[1]);
    let scratch =
        super::super::guard::Scratch::new(&store.disk, store.root(), "slow").expect("makes");
    store.retain(&keep(1, 0, true)).expect("retains");
    assert!(scratch.path().is_dir(), "its writer is alive");
    let path = scratch.path().to_owned();
    drop(scratch);
    assert!(!path.exists());
}

#[test]
fn what_is_pinned_tagged_best_periodic_or_a_milestone_stays() {
    let all: Vec<u64> = (1..=10).collect();
    let (_dir, store) = store_with(&all);
    store.pin(&nth(1), true).expect("pins");
    store.tag(&nth(2), "mine").expect("tags");
    store.set_milestone(&nth(3), true).expect("marks");
    store.record_score(&nth(5), score(0.1)).expect("scores");
    let planned = store.doomed(&keep(2, 4, true)).expect("plans");
    assert_eq!(planned, [6, 7].map(nth));
    assert_eq!(iterations(&store), all, "a plan removes nothing");
    assert_eq!(store.retain(&keep(2, 4, true)).expect("retains"), planned);
    assert_eq!(iterations(&store), [1, 2, 3, 4, 5, 8, 9, 10]);
    assert_eq!(store.retain(&keep(2, 0, false)).expect("retains"), [4, 5, 8].map(nth));
    assert_eq!(store.retain(&keep(0, 0, false)).expect("retains"), [nth(9)]);
    assert_eq!(iterations(&store), [1, 2, 3, 10], "the newest always stays");
}

#[test]
fn a_damaged_newest_one_does_not_count() {
    let (_dir, store) = store_with(&[1, 2, 3, 4]);
    let state = store.dir(&nth(3)).join(STATE);
    let bytes = std::fs::read(&state).expect("read");
    std::fs::write(&state, &bytes[1..]).expect("write");
    std::fs::remove_file(store.dir(&nth(4)).join(MANIFEST)).expect("remove");
    assert_eq!(store.retain(&keep(1, 0, true)).expect("retains"), [nth(1)]);
    assert_eq!(store.latest().expect("whole").manifest.iteration, 2);
    // As training goes on, the damaged ones go like others.
    for iteration in [5, 6] {
        commit(&store, iteration);
    }
    assert_eq!(store.retain(&keep(2, 0, true)).expect("retains"), [2, 3, 4].map(nth));
}

#[test]
fn what_a_run_could_not_go_on_from_does_not_push_out_what_it_commits() {
    let (_dir, store) = store_with(&[180, 190, 200, 250, 300]);
    // It went on from 190, because its metrics end before 200.
    commit(&store, 196);
    assert_eq!(store.retain_up_to(196, &keep(2, 0, false)).expect("retains"), [nth(180)]);
    assert_eq!(iterations(&store), [190, 196, 200, 250, 300]);
    assert_eq!(store.retain(&keep(2, 0, false)).expect("retains"), [190, 196, 200].map(nth));
}

/// A checkpoint of another run, copied into the store by hand, was taken for the newest of its own.
#[test]
fn what_the_run_has_not_come_to_does_not_push_out_its_own() {
    let (dir, store) = store_with(&[1, 2, 3]);
    let run = proto::run_dir::RunDir::new(dir.path());
    std::fs::write(run.config(), config().to_toml()).expect("write");
    let line = |iteration: u64| {
        let digest = snapshot_of(&config(), iteration + 1, 0.0).digest;
        format!("{{\"iteration\":{iteration},\"digest\":\"{digest}\"}}\n")
    };
    std::fs::write(run.metrics_jsonl(), (0..6).map(line).collect::<String>()).expect("write");
    commit_of(&store, &config(), &snapshot_of(&config(), 5, 9.0));
    assert_eq!(store.retain(&keep(1, 0, true)).expect("retains"), [1, 2].map(nth));
    commit(&store, 6);
    assert_eq!(store.retain(&keep(2, 0, true)).expect("retains"), []);
    assert_eq!(iterations(&store), [3, 5, 6]);
}

#[test]
fn nothing_is_removed_while_none_is_whole() {
    let (_dir, store) = store_with(&[1, 2]);
    for iteration in [1, 2] {
        std::fs::write(store.dir(&nth(iteration)).join(STATE), "damaged").expect("write");
    }
    assert_eq!(store.retain(&keep(1, 0, true)).expect("retains"), []);
}

#[test]
fn imported_ones_are_for_users_to_remove() {
    let (_dir, store) = store_with(&[1, 2]);
    let bytes = packed(&store, &nth(1));
    store.import(&bytes[..], Some(name("foreign"))).expect("imports");
    store.retain(&keep(1, 0, true)).expect("retains");
    assert_eq!(names(&store), ["foreign", "iteration-00000002"]);
    store.pin(&name("foreign"), true).expect("pins");
    assert!(matches!(store.delete(&name("foreign")), Err(CheckpointError::Pinned { .. })));
    store.pin(&name("foreign"), false).expect("unpins");
    store.delete(&name("foreign")).expect("removes");
    assert!(matches!(store.delete(&name("foreign")), Err(CheckpointError::Absent { .. })));
    assert_eq!(contents(store.root()), ["iteration-00000002"]);
}

#[test]
fn an_upload_of_a_later_iteration_crowds_nothing_out() {
    let (_dir, store) = store_with(&[1, 2]);
    let (_other_dir, other) = store_with(&[90, 91]);
    for iteration in [90, 91] {
        store.import(&packed(&other, &nth(iteration))[..], None).expect("imports");
    }
    assert_eq!(store.retain(&keep(1, 0, true)).expect("retains"), [nth(1)]);
    assert_eq!(iterations(&store), [2, 90, 91], "the run's newest, and what users brought");
    // What the run comes to itself is its own.
    commit(&store, 91);
    assert_eq!(store.retain(&keep(1, 0, true)).expect("retains"), [nth(2)]);
    assert_eq!(iterations(&store), [90, 91]);
}

#[test]
fn the_new_best_survives_the_retention_of_its_own_commit() {
    let (_dir, store) = store();
    let put = |iteration, value: Option<f64>| {
        let snapshot = snapshot_of(&config(), iteration, 0.0);
        let provenance = serde_json::json!({});
        let robot = robot().to_toml();
        let placement =
            store.commit_scored(&snapshot, &config(), &robot, &provenance, value.map(score));
        placement.expect("commits").best
    };
    assert!(put(10, Some(0.5)));
    assert!(!put(20, None));
    // Found to be the best only when newer ones are there.
    assert!(put(15, Some(0.25)));
    store.retain(&keep(1, 0, true)).expect("retains");
    assert_eq!(iterations(&store), [15, 20]);
    let entry = store.entry(&nth(15)).expect("there");
    assert_eq!(entry.labels.score, Some(score(0.25)));
    assert!(entry.labels.has_tag(BEST));

    // One that is there already only gets its score, and keeps it when it is committed again.
    assert!(put(20, Some(0.125)) && put(20, None));
    assert_eq!(store.entry(&nth(20)).expect("there").labels.score, Some(score(0.125)));
    let snapshot = snapshot_of(&config(), 30, 0.0);
    let nan = Some(score(f64::NAN));
    let refused = store.commit_scored(&snapshot, &config(), "", &serde_json::json!({}), nan);
    assert!(matches!(refused, Err(CheckpointError::Refused { .. })), "{refused:?}");
}

#[test]
fn what_was_replaced_stays_a_week_and_longer_if_it_was_pinned() {
    let (_dir, store) = store_with(&[1, 5]);
    let aside = |label: &str, days: u64, labels: &str| {
        let age = std::time::Duration::from_hours(24 * days);
        let made = std::time::SystemTime::now() - age;
        let nanos = made.duration_since(std::time::UNIX_EPOCH).expect("after 1970").as_nanos();
        let dir = store.root().join(format!(".replaced-{label}-77-0-{nanos:x}"));
        std::fs::create_dir(&dir).expect("mkdir");
        std::fs::write(dir.join(LABELS), labels).expect("write");
        dir
    };
    let fresh = aside("iteration-00000001", 6, "{}");
    let stale = aside("iteration-00000001", 8, "{}");
    let pinned = aside("x", 8, r#"{"pinned": true}"#);
    let tagged = aside("x", 9, r#"{"tags": ["mine"]}"#);
    let unreadable = aside("x", 10, "[");
    let unknown = store.root().join(".replaced-by-hand");
    std::fs::create_dir(&unknown).expect("mkdir");
    store.retain(&keep(1, 0, true)).expect("retains");
    assert!(!stale.exists());
    for dir in [fresh, pinned, tagged, unreadable, unknown] {
        assert!(dir.exists(), "{}", dir.display());
    }
}

#[test]
fn the_checkpoint_that_a_run_falls_back_to_is_not_removed() {
    let (dir, store) = store_with(&[1, 2, 3]);
    let needed = |iteration, is_live| matches!(store.delete(&nth(iteration)), Err(CheckpointError::Newest { live, .. }) if live == is_live);
    let run = proto::run_dir::RunDir::new(dir.path());
    std::fs::write(run.config(), config().to_toml()).expect("write");
    assert!(needed(3, false));
    // Damaged it is of no use, and the one before is what is needed.
    std::fs::write(store.dir(&nth(3)).join(STATE), "damaged").expect("write");
    assert!(needed(2, false));
    store.delete(&nth(3)).expect("removes");
    // What was given to the run is no replacement for its own.
    let (_other, other) = store_with(&[9]);
    store.import(&packed(&other, &nth(9))[..], None).expect_err("the robot is missing");
    std::fs::write(run.robot(), robot().to_toml()).expect("write");
    store.import(&packed(&other, &nth(9))[..], None).expect("imports");
    assert!(needed(2, false));
    store.pin(&nth(2), true).expect("pins");
    assert!(matches!(store.delete_even_newest(&nth(2)), Err(CheckpointError::Pinned { .. })));
    store.pin(&nth(2), false).expect("unpins");
    let lock = crate::lock::RunLock::acquire(&run.lock(), "octopus-0-12345678");
    assert!(needed(2, true));
    assert!(matches!(
        store.delete_even_newest(&nth(2)),
        Err(CheckpointError::Newest { live: true, .. })
    ));
    drop(lock.expect("free"));
    store.delete_even_newest(&nth(2)).expect("removes");
    store.delete(&nth(1)).expect_err("the last of its own");
    store.delete_even_newest(&nth(1)).expect("removes");
    assert!(needed(9, false), "all that there is");
    store.delete_even_newest(&nth(9)).expect("removes");
}
