//! Several writers and readers at once.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rusqlite::Connection;
use rustix::fs::{FlockOperation, flock};

use super::*;

#[test]
fn writers_of_every_kind_end_in_a_consistent_store() {
    let (_dir, store) = store_with(&[1]);
    let archive = packed(&store, &nth(1));
    let retention = Retention { latest: 2, every: 0, best: true };
    let done = AtomicBool::new(false);
    // Each thread has a store of its own, as each process would.
    let root = store.root().to_owned();
    let own = || CheckpointStore::new(&root);
    std::thread::scope(|scope| {
        let mut writers = vec![scope.spawn(|| {
            let store = own();
            for iteration in 2..14 {
                commit(&store, iteration);
                let value = 1.0 / iteration as f64;
                // Pruned meanwhile by another thread, unless it is the newest, which it is.
                store.record_score(&nth(iteration), score(value)).expect("scores");
                store.retain(&retention).expect("retains");
            }
        })];
        writers.push(scope.spawn(|| {
            let store = own();
            for round in 0..20 {
                let newest = store.latest().expect("always one").manifest.iteration;
                // It may have been removed since.
                let tagged = store.tag(&nth(newest), "mine");
                assert!(!matches!(tagged, Err(CheckpointError::Damaged { .. })), "{tagged:?}");
                let pinned = store.pin(&nth(newest), round % 2 == 0);
                assert!(!matches!(pinned, Err(CheckpointError::Damaged { .. })), "{pinned:?}");
            }
        }));
        for thread in 0..2 {
            let (archive, own) = (&archive, &own);
            writers.push(scope.spawn(move || {
                let store = own();
                for round in 0..6 {
                    let name = name(&format!("import-{}", round % 3));
                    store.import(&archive[..], Some(name.clone())).expect("the same checkpoint");
                    if thread == 0 {
                        store.retain(&retention).expect("retains");
                    }
                }
            }));
        }
        let reader = scope.spawn(|| {
            let store = own();
            let mut rounds = 0;
            while !done.load(Ordering::Relaxed) {
                let survey = store.survey().expect("readable");
                assert_eq!(survey.damaged, []);
                store.latest().expect("always one");
                rounds += 1;
            }
            rounds
        });
        let results: Vec<_> =
            writers.into_iter().map(std::thread::ScopedJoinHandle::join).collect();
        done.store(true, Ordering::Relaxed);
        for result in results {
            result.expect("no writer failed");
        }
        assert!(reader.join().expect("the reader never failed") > 0);
    });

    store.retain(&retention).expect("retains");
    let entries = store.entries().expect("readable");
    for entry in &entries {
        assert!(store.verify(&entry.name).expect("there").is_whole(), "{}", entry.name);
    }
    assert_eq!(store.latest().expect("whole").manifest.iteration, 13);
    assert_eq!(store.best().expect("reads").expect("scored").name, nth(13));
    for tag in ["mine", BEST] {
        let holders = entries.iter().filter(|entry| entry.labels.has_tag(tag)).count();
        assert!(holders <= 1, "{tag} is on {holders}");
    }
    let left: Vec<_> =
        contents(store.root()).into_iter().filter(|name| name.starts_with('.')).collect();
    assert!(left.is_empty(), "{left:?}");

    let database = Connection::open(store.root().join(CATALOGUE)).expect("opens");
    let mut statement = database.prepare("select name from checkpoints").expect("a table");
    let mut rows: Vec<String> =
        statement.query_map([], |row| row.get(0)).and_then(Iterator::collect).expect("reads");
    let mut names = names(&store);
    rows.sort();
    names.sort();
    assert_eq!(rows, names);
}

/// What is done to a store while somebody else might be waiting for it.
fn under_the_lock(
    prepare: impl Fn(&CheckpointStore),
    change: impl Fn(&CheckpointStore),
) -> Vec<String> {
    let (_dir, plain) = store();
    prepare(&plain);
    let seen = Arc::new(Mutex::new(Vec::new()));
    let (root, steps) = (plain.root().to_owned(), Arc::clone(&seen));
    let observer = move |step: super::super::disk::Step<'_>| {
        if super::super::guard::Guard::try_acquire(&root).is_none() {
            let path = step.path.strip_prefix(&root).unwrap_or(step.path);
            let text = format!("{} {}", step.action, path.display());
            steps.lock().expect("no panic").push(text);
        }
        Ok(())
    };
    let disk = super::super::disk::Disk::observed(Arc::new(observer));
    change(&CheckpointStore { disk, ..plain });
    let steps = seen.lock().expect("no panic").clone();
    assert!(steps.iter().any(|step| step.starts_with("rename")), "{steps:?}");
    steps
}

#[test]
fn no_tree_is_removed_while_others_wait() {
    let removed = |steps: Vec<String>| {
        assert!(!steps.iter().any(|step| step.starts_with("remove")), "{steps:#?}");
    };
    let three = |store: &CheckpointStore| {
        for iteration in [1, 2, 3] {
            commit(store, iteration);
        }
        let stale = store.root().join(".writing-stale-1-0-0");
        std::fs::create_dir(&stale).expect("mkdir");
        std::fs::write(stale.join(STATE), "a part").expect("write");
    };
    removed(under_the_lock(three, |store| {
        let retention = Retention { latest: 1, every: 0, best: true };
        store.retain(&retention).expect("retains");
        assert_eq!(contents(store.root()), ["iteration-00000003"]);
    }));
    removed(under_the_lock(three, |store| store.delete(&nth(2)).expect("removes")));
}

#[test]
fn what_changes_while_it_is_hashed_is_hashed_again() {
    let (_dir, plain) = store_with(&[1]);
    let bytes = packed(&plain, &nth(1));
    plain.import(&bytes[..], Some(name("x"))).expect("imports");
    let state = plain.dir(&name("x")).join(STATE);
    let whole = std::fs::read(&state).expect("read");
    // Damaged after it was found the same, before the lock is taken to say so.
    let (path, locks) = (state.clone(), AtomicUsize::new(0));
    let observer = move |step: super::super::disk::Step<'_>| {
        // The first lock is that of the scratch directory's parent, the second its own.
        if step.action == "lock" && locks.fetch_add(1, Ordering::Relaxed) == 2 {
            std::fs::write(&path, "damaged")?;
        }
        Ok(())
    };
    let disk = super::super::disk::Disk::observed(Arc::new(observer));
    let store = CheckpointStore { disk, ..plain };
    store.import(&bytes[..], Some(name("x"))).expect("mends");
    assert!(std::fs::read(&state).expect("read") == whole);
}

/// Whoever can open the lock can hold it, and once a run that was asked to stop waited for ever.
#[test]
fn a_lock_that_is_held_is_waited_for_only_so_long() {
    let (_dir, store) = store_with(&[1]);
    let path = store.root().join(".lock");
    let mode = || std::os::unix::fs::MetadataExt::mode(&path.metadata().expect("there")) & 0o777;
    assert_eq!(mode(), 0o600, "nobody else opens it");
    let lock = std::fs::File::open(&path).expect("own");
    flock(&lock, FlockOperation::LockExclusive).expect("free");

    let short = store.clone().with_patience(LockTimeout::new(Duration::from_millis(30)));
    let error = short.pin(&nth(1), true).expect_err("held");
    assert!(matches!(error, CheckpointError::Locked { .. }), "{error:?}");
    let said = error.to_string();
    assert!(said.contains(".lock") && said.contains("try again"), "{said}");
    assert!(said.contains(&format!("process {}", std::process::id())), "{said}");

    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    let patience = LockTimeout::new(Duration::from_hours(1));
    let long = store.clone().with_patience(patience.unless(move || asked.load(Ordering::Relaxed)));
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| long.pin(&nth(1), true));
        stop.store(true, Ordering::Relaxed);
        let error = waiting.join().expect("no panic").expect_err("stopped");
        assert!(matches!(error, CheckpointError::Locked { .. }), "{error:?}");
    });
    assert!(!store.entry(&nth(1)).expect("there").labels.pinned, "nothing was changed");
    drop(lock);
    store.pin(&nth(1), true).expect("free again");
}

#[test]
fn a_lock_of_an_earlier_version_is_closed_to_others() {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
    let (_dir, store) = store_with(&[1]);
    let path = store.root().join(".lock");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).expect("own");
    store.pin(&nth(1), true).expect("pins");
    assert_eq!(path.metadata().expect("there").mode() & 0o777, 0o600);
}

#[test]
fn a_lock_that_is_no_file_is_said_and_not_waited_for() {
    let (_dir, store) = store_with(&[1]);
    let path = store.root().join(".lock");
    std::fs::remove_file(&path).expect("there");
    let made = std::process::Command::new("mkfifo").arg(&path).status();
    assert!(made.expect("starts").success());
    let error = store.pin(&nth(1), true).expect_err("a pipe").to_string();
    assert!(error.contains(".lock") && error.contains("is a pipe"), "{error}");
    store.heal_catalogue();
    store.latest().expect("readers need no lock");
}
