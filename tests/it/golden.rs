//! The bits of before; `make golden` checks all trainings.

use tests::golden::{Digests, Golden, blocks, differences, evaluations, processor, trainings};

#[test]
fn blocks_are_the_recorded_ones_on_every_back_end() {
    let golden = Golden::read().expect("a record");
    let found = blocks().expect("blocks");
    assert_eq!(found.len(), golden.blocks.len());
    assert_eq!(differences(&golden.blocks, &found), Vec::<String>::new());
}

#[test]
fn evaluations_are_the_recorded_ones_on_every_back_end() {
    let golden = Golden::read().expect("a record");
    let found = evaluations().expect("evaluations");
    assert_eq!(found.len(), golden.evaluations.len());
    assert_eq!(differences(&golden.evaluations, &found), Vec::<String>::new());
}

/// On a type of processor that nothing is recorded for, only that trainings repeat themselves.
#[test]
fn trainings_are_the_recorded_ones() {
    let golden = Golden::read().expect("a record");
    let found = trainings(true, &|_| ()).expect("trainings");
    assert_eq!(found.len(), 8, "four algorithms, two precisions");
    let recorded: Digests = match golden.trainings.get(&processor()) {
        Some(recorded) => recorded.clone(),
        None => trainings(true, &|_| ()).expect("trainings"),
    };
    assert_eq!(differences(&recorded, &found), Vec::<String>::new());
}
