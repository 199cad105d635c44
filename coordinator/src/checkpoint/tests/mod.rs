//! Tests of the checkpoint store, and the checkpoints that they work on.

mod archive;
mod catalogue;
mod compare;
mod compose;
mod concurrency;
mod crash;
mod labels;
mod name;
mod retention;
mod selector;
mod store;
mod verify;

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use proto::DigestBuilder;
use proto::config::{Config, Layers, Preset};
use proto::layout::{ActorLayout, Dimensions};
use safetensors::{Dtype, tensor::TensorView};
use simulator::robot::Robot;
use tempfile::TempDir;

use super::*;

/// Length of the training state's largest tensor: several chunks of a write.
const WEIGHTS: usize = 50_000;

fn config_with(set: &[&str]) -> Config {
    let layers = Layers::new(Preset::Tuned, None).set("network.hidden=[4]").expect("valid");
    let layers = set.iter().try_fold(layers, |layers, set| layers.set(set)).expect("valid");
    layers.resolve().expect("valid")
}

fn config() -> Config {
    config_with(&[])
}

fn robot() -> Robot {
    Robot::builtin("paper").expect("built in")
}

/// A snapshot whose actors count up from `first`, with a training state of `n_weights` numbers and
/// the digest that the learner would compute for it.
pub(crate) fn snapshot_of(
    config: &Config,
    iteration: u64,
    first: f32,
    n_weights: usize,
) -> Snapshot {
    let layout = ActorLayout::new(config, &Dimensions::new(config, robot().n_arms));
    let actors: Vec<u8> =
        (0..layout.len).flat_map(|index| (first + index as f32).to_le_bytes()).collect();
    let weights: Vec<u8> =
        (0..n_weights).flat_map(|index| (iteration as f32 + index as f32).to_le_bytes()).collect();
    let env_steps = iteration * config.steps_per_iteration();
    let (iteration_bytes, env_steps) = (iteration.to_le_bytes(), env_steps.to_le_bytes());
    let own = [
        ("actor.head.weight", Dtype::F32, vec![n_weights], &weights[..]),
        ("counters.env_steps", Dtype::U64, vec![1], &env_steps[..]),
        ("counters.iteration", Dtype::U64, vec![1], &iteration_bytes[..]),
    ];
    let mut digest = DigestBuilder::new();
    let mut tensors = Vec::new();
    for (name, dtype, shape, bytes) in own {
        digest.field(name, bytes);
        tensors.push((name.to_owned(), TensorView::new(dtype, shape, bytes).expect("sized")));
    }
    for spec in &layout.tensors {
        let bytes = &actors[4 * spec.offset..4 * spec.range().end];
        let view = TensorView::new(Dtype::F32, spec.shape.clone(), bytes).expect("sized");
        tensors.push((format!("policy.{}", spec.name), view));
    }
    let metadata = HashMap::from([("format".to_owned(), "test".to_owned())]);
    let bytes = safetensors::serialize(tensors, Some(metadata)).expect("serialises");
    Snapshot { iteration, digest: digest.finish(), bytes }
}

fn commit_of(store: &CheckpointStore, config: &Config, snapshot: &Snapshot) -> std::path::PathBuf {
    let provenance = serde_json::json!({ "host": "a test" });
    store.commit(snapshot, config, &robot().to_toml(), &provenance).expect("commits")
}

/// Commits a small checkpoint.
fn commit(store: &CheckpointStore, iteration: u64) -> std::path::PathBuf {
    commit_of(store, &config(), &snapshot_of(&config(), iteration, 0.0, 10))
}

/// A store in a directory that goes away.
fn store() -> (TempDir, CheckpointStore) {
    let dir = tempfile::tempdir().expect("tempdir");
    let store = CheckpointStore::new(dir.path().join("checkpoints"));
    (dir, store)
}

/// A store with small checkpoints of these iterations.
fn store_with(iterations: &[u64]) -> (TempDir, CheckpointStore) {
    let (dir, store) = store();
    for &iteration in iterations {
        commit(&store, iteration);
    }
    (dir, store)
}

fn name(text: &str) -> Name {
    text.parse().expect("a name")
}

fn nth(iteration: u64) -> Name {
    Name::of_iteration(iteration)
}

fn score(value: f64) -> Score {
    let errors = BTreeMap::from([("position".to_owned(), value)]);
    Score { value, errors, episodes: 30, steps: 200, seed: 0 }
}

/// Names of a store's checkpoints, in their order.
fn names(store: &CheckpointStore) -> Vec<String> {
    store.entries().expect("readable").iter().map(|entry| entry.name.to_string()).collect()
}

/// Everything in a directory but the lock and the catalogue; of none, nothing.
fn contents(dir: &Path) -> Vec<String> {
    if !dir.exists() {
        return Vec::new();
    }
    let mut found: Vec<String> = std::fs::read_dir(dir)
        .expect("readable")
        .map(|entry| entry.expect("entry").file_name().into_string().expect("UTF-8"))
        .filter(|name| name != ".lock" && !name.starts_with(CATALOGUE))
        .collect();
    found.sort();
    found
}

/// An archive of the checkpoint.
fn packed(store: &CheckpointStore, name: &Name) -> Vec<u8> {
    let mut bytes = Vec::new();
    store.export(name, &mut bytes).expect("exports");
    bytes
}
