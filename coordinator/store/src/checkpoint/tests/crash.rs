//! Every change of a store, cut off or failing before each of its steps.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::super::disk::Disk;
use super::*;

/// What happens at a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// `kill -9`, or the power: this step and all later ones never happen.
    Killed,
    /// This step fails for want of space; cleaning up still works.
    Full,
}

/// A store that suffers `fault` at its step number `at`, and the steps that it has taken.
fn faulty(store: &CheckpointStore, fault: Fault, at: usize) -> (CheckpointStore, Arc<AtomicUsize>) {
    let taken = Arc::new(AtomicUsize::new(0));
    let counter = Arc::clone(&taken);
    let observer = Arc::new(move |_: super::super::disk::Step<'_>| {
        let step = counter.fetch_add(1, Ordering::Relaxed);
        match fault {
            Fault::Killed if step >= at => Err(io::Error::other("killed")),
            Fault::Full if step == at => Err(io::ErrorKind::StorageFull.into()),
            _ => Ok(()),
        }
    });
    (CheckpointStore { disk: Disk::observed(observer), ..store.clone() }, taken)
}

/// Calls `attempt` with a fault at step 0, 1, … in a fresh store each, until it runs through, and
/// `check` afterwards with what it returned. Returns the number of steps.
fn at_every_step(
    fault: Fault,
    prepare: impl Fn() -> (TempDir, CheckpointStore),
    attempt: impl Fn(&CheckpointStore) -> Result<(), CheckpointError>,
    check: impl Fn(&CheckpointStore, usize, Result<(), CheckpointError>),
) -> usize {
    for at in 0.. {
        let (_dir, store) = prepare();
        let (broken, taken) = faulty(&store, fault, at);
        let outcome = attempt(&broken);
        let steps = taken.load(Ordering::Relaxed);
        drop(broken);
        check(&store, at, outcome);
        if steps <= at {
            return steps;
        }
    }
    unreachable!("every change ends")
}

const BOTH: [Fault; 2] = [Fault::Killed, Fault::Full];

/// Nothing but whole checkpoints is in sight, and after a retention nothing else is there at all.
fn assert_clean(store: &CheckpointStore, context: &str) {
    let survey = store.survey().expect("readable");
    assert_eq!(survey.damaged, [], "{context}");
    for entry in &survey.entries {
        let found = store.verify(&entry.name).expect("there");
        assert!(found.is_whole(), "{context}: {:?}", found.problems);
    }
    let retention = Retention { latest: 100, every: 0, best: true };
    store.retain(&retention).expect("retains");
    for name in contents(store.root()) {
        let temporary = name.starts_with('.') && !name.starts_with(".replaced-");
        assert!(!temporary, "{context}: {name} is left");
        let stump = contents(&store.root().join(&name)).into_iter().find(|f| f.starts_with('.'));
        assert_eq!(stump, None, "{context}: in {name}");
    }
}

#[test]
fn a_commit() {
    let snapshot = snapshot_of(&large(), 2, 0.0);
    let commit_second = |store: &CheckpointStore| {
        let robot = robot().to_toml();
        store.commit(&snapshot, &large(), &robot, &serde_json::json!({})).map(|_| ())
    };
    for fault in BOTH {
        let steps = at_every_step(
            fault,
            || store_with(&[1]),
            commit_second,
            |store, at, outcome| {
                let context = format!("{fault:?} at step {at}");
                let newest = store.latest().expect(&context).manifest.iteration;
                assert!(newest == 1 || newest == 2, "{context}");
                if outcome.is_ok() {
                    assert_eq!(newest, 2, "{context}: it said that it was done");
                }
                if fault == Fault::Full && newest == 1 {
                    assert_eq!(contents(store.root()), ["iteration-00000001"], "{context}");
                }
                commit_second(store).expect(&context);
                let latest = store.latest().expect(&context).manifest;
                assert_eq!((latest.iteration, latest.digest), (2, snapshot.digest), "{context}");
                assert_clean(store, &context);
            },
        );
        // Lock and directory, five files in all their chunks, their syncs, rename, catalogue.
        let chunks = snapshot.bytes.len() / super::super::disk::CHUNK;
        assert!(steps > 20 + chunks, "{steps} steps, of which {chunks} are chunks");
    }
}

#[test]
fn a_first_commit() {
    for fault in BOTH {
        at_every_step(
            fault,
            super::store,
            |store| {
                let robot = robot().to_toml();
                let snapshot = snapshot_of(&config(), 1, 0.0);
                store.commit(&snapshot, &config(), &robot, &serde_json::json!({})).map(|_| ())
            },
            |store, at, _| {
                commit(store, 1);
                assert_eq!(store.latest().expect("whole").manifest.iteration, 1, "{fault:?} {at}");
                assert_clean(store, &format!("{fault:?} at step {at}"));
            },
        );
    }
}

#[test]
fn a_commit_that_replaces_a_damaged_one() {
    for fault in BOTH {
        at_every_step(
            fault,
            || {
                let (dir, store) = store_with(&[1, 2]);
                std::fs::write(store.dir(&nth(2)).join(STATE), "damaged").expect("write");
                (dir, store)
            },
            |store| {
                let robot = robot().to_toml();
                let snapshot = snapshot_of(&config(), 2, 0.0);
                store.commit(&snapshot, &config(), &robot, &serde_json::json!({})).map(|_| ())
            },
            |store, at, _| {
                let context = format!("{fault:?} at step {at}");
                store.latest().expect(&context);
                commit(store, 2);
                assert_eq!(store.latest().expect(&context).manifest.iteration, 2, "{context}");
                assert_clean(store, &context);
            },
        );
    }
}

#[test]
fn a_retention() {
    let retention = Retention { latest: 1, every: 0, best: true };
    for fault in BOTH {
        at_every_step(
            fault,
            || {
                let (dir, store) = store_with(&[1, 2, 3, 4]);
                store.record_score(&nth(2), score(0.1)).expect("scores");
                (dir, store)
            },
            |store| store.retain(&retention).map(|_| ()),
            |store, at, _| {
                let context = format!("{fault:?} at step {at}");
                assert_eq!(store.latest().expect(&context).manifest.iteration, 4, "{context}");
                assert_eq!(store.best().expect("reads").expect("kept").name, nth(2), "{context}");
                assert_clean(store, &context);
                store.retain(&retention).expect(&context);
                assert_eq!(names(store), [nth(2), nth(4)].map(|name| name.to_string()));
            },
        );
    }
}

#[test]
fn a_removal() {
    for fault in BOTH {
        at_every_step(
            fault,
            || store_with(&[1, 2]),
            |store| store.delete(&nth(1)),
            |store, at, outcome| {
                let context = format!("{fault:?} at step {at}");
                let gone = names(store) == ["iteration-00000002"];
                assert!(gone || outcome.is_err(), "{context}");
                assert_clean(store, &context);
            },
        );
    }
}

#[test]
fn a_tag_that_moves_is_never_lost() {
    for fault in BOTH {
        at_every_step(
            fault,
            || {
                let (dir, store) = store_with(&[1, 2]);
                store.tag(&nth(1), "mine").expect("tags");
                (dir, store)
            },
            |store| store.tag(&nth(2), "mine"),
            |store, at, outcome| {
                let context = format!("{fault:?} at step {at}");
                let entries = store.entries().expect("readable");
                let holders: Vec<_> = entries
                    .iter()
                    .filter(|entry| entry.labels.has_tag("mine"))
                    .map(|entry| entry.name.clone())
                    .collect();
                assert!(!holders.is_empty(), "{context}");
                if outcome.is_ok() {
                    assert_eq!(holders, [nth(2)], "{context}");
                }
                assert_clean(store, &context);
            },
        );
    }
}

#[test]
fn a_score() {
    for fault in BOTH {
        at_every_step(
            fault,
            || {
                let (dir, store) = store_with(&[1, 2]);
                store.record_score(&nth(1), score(0.5)).expect("scores");
                (dir, store)
            },
            |store| store.record_score(&nth(2), score(0.1)).map(|_| ()),
            |store, at, _| {
                let context = format!("{fault:?} at step {at}");
                assert_clean(store, &context);
                // Whatever was done, the tag is where the scores say after the next change.
                let best = store.best().expect("reads").expect("scored").name;
                let tagged: Vec<_> = store
                    .entries()
                    .expect("readable")
                    .into_iter()
                    .filter(|entry| entry.labels.has_tag(BEST))
                    .map(|entry| entry.name)
                    .collect();
                assert_eq!(tagged, [best], "{context}");
            },
        );
    }
}

#[test]
fn an_import() {
    let (_dir, source) = super::store();
    commit_of(&source, &large(), &snapshot_of(&large(), 5, 0.0));
    let archive = packed(&source, &nth(5));
    for fault in BOTH {
        at_every_step(
            fault,
            || store_with(&[1]),
            |store| store.import(&archive[..], Some(name("foreign"))).map(|_| ()),
            |store, at, _| {
                let context = format!("{fault:?} at step {at}");
                assert_eq!(store.latest().expect(&context).manifest.iteration, 1, "{context}");
                store.import(&archive[..], Some(name("foreign"))).expect(&context);
                assert_eq!(names(store), ["foreign", "iteration-00000001"], "{context}");
                assert_clean(store, &context);
            },
        );
    }
}
