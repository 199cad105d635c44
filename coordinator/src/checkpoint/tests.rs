use std::collections::HashMap;

use proto::Digest;
use proto::config::{Config, Layers, Preset};
use proto::layout::{ActorLayout, Dimensions, SnapshotHeader};
use safetensors::{Dtype, tensor::TensorView};

use super::*;

fn config() -> Config {
    Layers::new(Preset::Tuned, None)
        .set("network.hidden=[4]")
        .and_then(|layers| layers.resolve())
        .expect("valid")
}

/// A snapshot whose actors count up and whose training state is one number.
fn snapshot(iteration: u64) -> Snapshot {
    let layout = ActorLayout::new(&config(), &Dimensions::new(&config(), 4));
    let values: Vec<u8> = (0..layout.len).flat_map(|index| (index as f32).to_le_bytes()).collect();
    let state = iteration.to_le_bytes();
    let mut tensors = vec![(
        "counter".to_owned(),
        TensorView::new(Dtype::I64, vec![1], &state).expect("eight bytes"),
    )];
    for spec in &layout.tensors {
        let bytes = &values[4 * spec.offset..4 * spec.range().end];
        let view = TensorView::new(Dtype::F32, spec.shape.clone(), bytes).expect("sized");
        tensors.push((format!("policy.{}", spec.name), view));
    }
    let metadata = HashMap::from([("iteration".to_owned(), iteration.to_string())]);
    let bytes = safetensors::serialize(tensors, Some(metadata)).expect("serialises");
    Snapshot { iteration, digest: Digest([iteration as u8; 16]), bytes }
}

fn commit(store: &CheckpointStore, iteration: u64) -> PathBuf {
    store
        .commit(&snapshot(iteration), &config(), "name = \"r\"", &serde_json::json!({}))
        .expect("commits")
}

#[test]
fn a_committed_snapshot_comes_back() {
    let dir = tempfile::tempdir().expect("tempdir");
    let store = CheckpointStore::new(dir.path().join("checkpoints"));
    let path = commit(&store, 7);
    let checkpoint = store.latest().expect("there is one");
    assert_eq!(checkpoint.dir, path);
    assert_eq!(checkpoint.manifest.iteration, 7);
    assert_eq!(checkpoint.manifest.env_steps, 7 * config().steps_per_iteration());
    assert_eq!(checkpoint.config, config());
    let actors = checkpoint.actors(4).expect("actors");
    let layout = ActorLayout::new(&config(), &Dimensions::new(&config(), 4));
    let bias = layout.get("head.bias").expect("every actor has one");
    assert_eq!(actors[bias.offset], bias.offset as f32);
}

#[test]
fn pruning_keeps_the_newest_and_sweeps_killed_commits() {
    let dir = tempfile::tempdir().expect("tempdir");
    let store = CheckpointStore::new(dir.path());
    for iteration in [100, 3, 20] {
        commit(&store, iteration);
    }
    std::fs::create_dir(dir.path().join(".writing-iteration-00000200")).expect("mkdir");
    store.prune(2).expect("prunes");
    let names: Vec<_> = std::fs::read_dir(dir.path())
        .expect("read")
        .map(|entry| entry.expect("entry").file_name().into_string().expect("UTF-8"))
        .collect::<std::collections::BTreeSet<_>>()
        .into_iter()
        .collect();
    assert_eq!(names, ["iteration-00000020", "iteration-00000100"]);
}

#[test]
fn a_flipped_byte_anywhere_is_found_and_the_checkpoint_before_is_taken() {
    for file in [STATE, POLICY, "config.toml", "robot.toml", MANIFEST] {
        let dir = tempfile::tempdir().expect("tempdir");
        let store = CheckpointStore::new(dir.path());
        commit(&store, 1);
        let newest = commit(&store, 2);
        let path = newest.join(file);
        let mut bytes = std::fs::read(&path).expect("read");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x80;
        std::fs::write(&path, bytes).expect("write");
        assert!(store.load(&newest).is_err(), "{file}");
        assert_eq!(store.latest().expect("the older one").manifest.iteration, 1, "{file}");
    }
}

#[test]
fn a_truncated_file_is_named() {
    let dir = tempfile::tempdir().expect("tempdir");
    let store = CheckpointStore::new(dir.path());
    let path = commit(&store, 1).join(STATE);
    let bytes = std::fs::read(&path).expect("read");
    std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("write");
    let message = store.latest().expect_err("the only one is damaged").to_string();
    assert!(
        message.contains("state.safetensors") && message.contains("manifest says"),
        "{message}"
    );
}

#[test]
fn an_empty_store_says_so() {
    let dir = tempfile::tempdir().expect("tempdir");
    let error = CheckpointStore::new(dir.path().join("none")).latest().expect_err("empty");
    assert!(matches!(error, CheckpointError::NotFound { .. }), "{error}");
}

#[test]
fn pieces_of_a_dead_learner_do_not_mix_with_its_successors() {
    let mut assembly = Assembly::new();
    let header =
        |offset, total, iteration| SnapshotHeader { iteration, offset, total, digest: [0; 16] };
    assert_eq!(assembly.add(&header(0, 4, 1), b"ab"), Ok(None));
    // The learner died; its successor starts from the beginning.
    assert_eq!(assembly.add(&header(0, 3, 2), b"xy"), Ok(None));
    assert!(assembly.add(&header(2, 4, 1), b"cd").is_err(), "a piece of the dead one");
    assert_eq!(assembly.add(&header(0, 3, 2), b"xyz").expect("whole").expect("done").bytes, b"xyz");
}
