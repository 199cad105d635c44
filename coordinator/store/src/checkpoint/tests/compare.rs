use super::*;

#[test]
fn a_checkpoint_is_the_same_as_itself() {
    let (_dir, store) = store_with(&[1]);
    let checkpoint = store.latest().expect("whole");
    let difference = super::compare(&checkpoint, &checkpoint).expect("compares");
    assert!(difference.same && difference.config.is_empty() && difference.tensors.is_empty());
    assert_eq!(difference.equal_tensors, store.verify(&nth(1)).expect("there").tensors);
}

#[test]
fn keys_and_tensors_that_differ_are_told_with_how_much() {
    let (_dir, store) = store();
    let (one, two) = (config(), config_with(&["run.seed=9"]));
    commit_of(&store, &one, &snapshot_of(&one, 1, 0.0));
    commit_of(&store, &two, &snapshot_of(&two, 2, 0.0));
    let load = |iteration| store.load(&store.dir(&nth(iteration))).expect("whole");
    let difference = super::compare(&load(1), &load(2)).expect("compares");
    assert!(!difference.same && difference.same_robot);
    let keys: Vec<_> = difference.config.iter().map(|key| key.key.as_str()).collect();
    assert_eq!(keys, ["run.seed"]);
    assert_eq!(difference.config[0].b.as_deref(), Some("9"));
    // Each of the 8 biases is larger by one.
    let biases = difference.tensors.iter().find(|t| t.tensor.ends_with("/critic.head.bias"));
    let biases = biases.expect("it differs");
    assert_eq!((biases.max_abs, biases.norm), (Some(1.0), Some(8.0_f64.sqrt())));
    let counter = difference.tensors.iter().find(|t| t.tensor.ends_with("counters.iteration"));
    assert_eq!(counter.expect("it differs").max_abs, Some(1.0));
}

#[test]
fn tensors_of_one_side_only_have_no_distance() {
    let (_dir, store) = store();
    let one = config();
    let two = config_with(&["network.layer_norm=true"]);
    let three = config_with(&["network.layer_norm=false"]);
    let with = if one.network.layer_norm { one } else { two };
    commit_of(&store, &with, &snapshot_of(&with, 1, 0.0));
    commit_of(&store, &three, &snapshot_of(&three, 2, 0.0));
    let load = |iteration| store.load(&store.dir(&nth(iteration))).expect("whole");
    let difference = super::compare(&load(1), &load(2)).expect("compares");
    let gain = difference.tensors.iter().find(|t| t.tensor.ends_with("hidden.0.gain"));
    let gain = gain.expect("only in the first");
    assert!(gain.a.is_some() && gain.b.is_none() && gain.max_abs.is_none());
}
