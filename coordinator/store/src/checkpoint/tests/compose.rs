use proto::agents::Joints;
use safetensors::SafeTensors;

use super::*;

/// A checkpoint of another run, whose actors count up from `first`.
fn trained(dir: &TempDir, run: &str, set: &[&str], first: f32) -> Checkpoint {
    let store = CheckpointStore::new(dir.path().join(run));
    let config = config_with(set);
    commit_of(&store, &config, &snapshot_of(&config, first as u64 + 1, first));
    store.latest().expect("whole")
}

fn part(arms: &[usize], checkpoint: &Checkpoint) -> Part {
    Part { arms: arms.to_vec(), checkpoint: checkpoint.clone() }
}

fn compose(parts: &[Part]) -> Result<Composition, CheckpointError> {
    Composition::new(&Parts::new(parts.to_vec())?)
}

fn refused(parts: &[Part]) -> String {
    compose(parts).expect_err("they do not fit").to_string()
}

#[test]
fn every_arm_keeps_its_own_rows_and_its_origin() {
    let dir = tempfile::tempdir().expect("tempdir");
    let (a, b) = (trained(&dir, "a", &[], 0.0), trained(&dir, "b", &["run.seed=9"], 5000.0));
    let parts = [part(&[2, 0], &a), part(&[1, 3], &b)];
    let composition = compose(&parts).expect("they fit");
    assert!(composition.notes.is_empty(), "{:?}", composition.notes);
    let store = CheckpointStore::new(dir.path().join("shared"));
    let provenance = serde_json::json!({});
    let entry = store.compose(&name("mixed"), &composition, &provenance).expect("commits");
    assert_eq!((entry.kind, entry.iteration), (Kind::Composed, 5001));
    let origins: Vec<_> =
        entry.origins.iter().map(|o| (o.agent, o.source_agent, o.digest)).collect();
    let (x, y) = (a.manifest.digest, b.manifest.digest);
    let expected: Vec<_> =
        [x, x, y, y, x, x, y, y].into_iter().enumerate().map(|(i, d)| (i, i, d)).collect();
    assert_eq!(origins, expected);

    let composed = store.load(&entry.dir).expect("whole");
    assert!(!composed.manifest.has_state());
    assert!(store.verify(&entry.name).expect("there").is_whole());
    let (actors, from_a, from_b) = (
        composed.actors(Joints::of_sixes(4)),
        a.actors(Joints::of_sixes(4)),
        b.actors(Joints::of_sixes(4)),
    );
    let (actors, from_a, from_b) =
        (actors.expect("actors"), from_a.expect("actors"), from_b.expect("actors"));
    let layout = ActorLayout::new(&config(), &Dimensions::new(&config(), Joints::of_sixes(4)));
    for tensor in &layout.tensors {
        let len = tensor.len() / 8;
        for agent in 0..8 {
            let row = tensor.offset + agent * len..tensor.offset + (agent + 1) * len;
            let source = if [0, 1, 4, 5].contains(&agent) { &from_a } else { &from_b };
            assert_eq!(actors[row.clone()], source[row], "{} of agent {agent}", tensor.name);
        }
    }

    // The digest is what anybody computes from the file.
    let bytes = std::fs::read(entry.dir.join(POLICY)).expect("read");
    let tensors = SafeTensors::deserialize(&bytes).expect("whole");
    let mut names: Vec<_> = tensors.names();
    names.sort_unstable();
    let mut digest = DigestBuilder::new();
    for name in names {
        digest.field(name, tensors.tensor(name).expect("there").data());
    }
    assert_eq!(entry.digest, digest.finish());

    // It is no run's own: not the latest, and no retention removes it.
    assert!(store.latest().is_err());
    let again = store.compose(&name("mixed"), &composition, &provenance).expect("the same again");
    assert_eq!(again, entry);
    let other = compose(&[part(&[0, 1, 2, 3], &a)]).expect("fits");
    let error = store.compose(&name("mixed"), &other, &provenance).expect_err("another");
    assert!(matches!(error, CheckpointError::Conflict { .. }), "{error}");
    assert!(store.compose(&nth(1), &composition, &provenance).is_err(), "a run's name");
}

#[test]
fn every_arm_is_given_once() {
    let dir = tempfile::tempdir().expect("tempdir");
    let a = trained(&dir, "a", &[], 0.0);
    assert!(refused(&[]).contains("at least one"));
    let message = refused(&[part(&[0, 2], &a)]);
    assert!(message.contains("no part has arm 2, 4"), "{message}");
    let message = refused(&[part(&[0, 1, 2, 3], &a), part(&[2], &a)]);
    assert!(message.contains("arm 3 is given twice"), "{message}");
    let message = refused(&[part(&[0, 1, 2, 3, 4], &a)]);
    assert!(message.contains("no arm 5") && message.contains("has 4"), "{message}");
}

#[test]
fn what_does_not_go_together_is_refused_with_both_sides() {
    let dir = tempfile::tempdir().expect("tempdir");
    let a = trained(&dir, "a", &[], 0.0);
    for (index, (set, key)) in [
        ("task.observation=\"paper\"", "task.observation"),
        ("task.posture.seen=true", "task.posture.seen"),
        ("task.action_scale=0.123", "task.action_scale"),
        ("env.control_period=0.8", "env.control_period"),
        ("network.hidden=[5]", "network.hidden"),
        ("network.activation=\"relu\"", "network.activation"),
        ("network.layer_norm=true", "network.layer_norm"),
        ("network.squash_mean=false", "network.squash_mean"),
        ("network.input_clip=77.0", "network.input_clip"),
        ("network.input_norm=\"none\"", "network.input_norm"),
        ("network.inference=\"f32\"", "network.inference"),
        ("algorithm.name=\"ppo\"", "the kind of actor"),
    ]
    .into_iter()
    .enumerate()
    {
        let b = trained(&dir, &format!("b{index}"), &[set], 0.0);
        assert_ne!(b.config, a.config, "{set} is the preset's own value");
        let message = refused(&[part(&[0, 1, 2], &a), part(&[3], &b)]);
        for word in [key, "arms 1,2,3 (", "arm 4 (", "must be equal"] {
            assert!(message.contains(word), "{set}: `{word}` is not in: {message}");
        }
    }
    let seen = "task.posture.seen=true";
    let guided = trained(&dir, "e", &[seen], 0.0);
    let gain = "task.posture.gain=0.3";
    let guided_by_itself = trained(&dir, "g", &[seen, gain], 0.0);
    for (index, (first, key, set)) in [
        (&guided, "task.posture.gain", &[seen, gain][..]),
        (&guided, "task.posture.trust", &[seen, "task.posture.trust=0.3"]),
        (&guided_by_itself, "task.posture.fade", &[seen, gain, "task.posture.fade=0.3"]),
    ]
    .into_iter()
    .enumerate()
    {
        let other = trained(&dir, &format!("f{index}"), set, 0.0);
        let message = refused(&[part(&[0, 1, 2], first), part(&[3], &other)]);
        assert!(message.contains(key) && message.contains("must be equal"), "{message}");
    }
    let b = trained(&dir, "c", &["task.name=\"reorientation\""], 0.0);
    let message = refused(&[part(&[0, 1, 2], &a), part(&[3], &b)]);
    assert!(message.contains("different tasks cannot be mixed"), "{message}");
    assert!(message.contains("`trajectory`") && message.contains("`reorientation`"), "{message}");

    let mut b = trained(&dir, "d", &[], 0.0);
    b.robot_toml = Robot::builtin("release").expect("built in").to_toml();
    let message = refused(&[part(&[0, 1, 2], &a), part(&[3], &b)]);
    assert!(message.contains("different robots"), "{message}");
}

#[test]
fn one_actor_for_all_arms_is_not_taken_apart() {
    let dir = tempfile::tempdir().expect("tempdir");
    let [a, b] = ["a", "b"].map(|name| trained(&dir, name, &["algorithm.name=\"ppo\""], 0.0));
    let message = refused(&[part(&[0, 1], &a), part(&[2, 3], &b)]);
    assert!(message.contains("arms 1,2 (") && message.contains("= ppo"), "{message}");
}

#[test]
fn what_only_matters_for_training_is_noted() {
    let dir = tempfile::tempdir().expect("tempdir");
    let a = trained(&dir, "a", &[], 0.0);
    let b = trained(&dir, "b", &["task.episode_steps=77", "algorithm.gamma=0.5"], 0.0);
    let parts = [part(&[0, 1], &a), part(&[2, 3], &b)];
    let composition = compose(&parts).expect("they fit");
    assert_eq!(composition.notes, ["task.episode_steps"]);
}

#[test]
fn the_same_tensors_under_another_configuration_are_another_composition() {
    let dir = tempfile::tempdir().expect("tempdir");
    let (a, b) = (
        trained(&dir, "a", &["task.episode_steps=66"], 0.0),
        trained(&dir, "b", &["task.episode_steps=77"], 5000.0),
    );
    let of = |parts: &[Part]| compose(parts).expect("they fit");
    let (one, other) = (part(&[0, 1], &a), part(&[2, 3], &b));
    let first = of(&[one.clone(), other.clone()]);
    let second = of(&[other, one]);
    let store = CheckpointStore::new(dir.path().join("shared"));
    let provenance = serde_json::json!({});
    let there = store.compose(&name("x"), &first, &provenance).expect("commits");
    let error = store.compose(&name("x"), &second, &provenance).expect_err("b decides now");
    assert!(matches!(error, CheckpointError::Conflict { .. }), "{error}");
    assert!(error.to_string().contains("the same tensors but another config.toml"), "{error}");
    assert_eq!(store.compose(&name("x"), &first, &provenance).expect("the same again"), there);

    let entry = store.compose(&name("y"), &second, &provenance).expect("commits");
    assert_eq!(entry.digest, there.digest);
    let error = store.import(&packed(&store, &name("y"))[..], Some(name("x"))).expect_err("too");
    assert!(matches!(error, CheckpointError::Conflict { .. }), "{error}");
}
