//! Tests of the checkpoint store, and the checkpoints that they work on.

mod archive;
mod catalogue;
mod compare;
mod compose;
mod concurrency;
mod crash;
mod labels;
mod name;
mod privacy;
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

fn config_with(set: &[&str]) -> Config {
    let small = ["network.hidden=[4]", "network.critic_hidden=[4]"];
    let layers = Layers::new(Preset::Tuned, None);
    let layers = small.iter().chain(set).try_fold(layers, |layers, set| layers.set(set));
    let layers = layers.expect("valid");
    layers.resolve().expect("valid")
}

fn config() -> Config {
    config_with(&[])
}

fn robot() -> Robot {
    Robot::builtin("paper").expect("built in")
}

/// A configuration whose training state takes several chunks of a write.
fn large() -> Config {
    config_with(&["network.critic_hidden=[64]"])
}

/// A snapshot whose actors count up from `first` and whose critics from the iteration, with all
/// tensors that a learner would write and the digest that it would compute for them.
pub(crate) fn snapshot_of(config: &Config, iteration: u64, first: f32) -> Snapshot {
    let dimensions = Dimensions::new(config, robot().n_arms);
    let actors = ActorLayout::new(config, &dimensions);
    let state = StateLayout::new(config, &dimensions);
    let count = |first: f32, numbers: std::ops::Range<usize>| -> Vec<u8> {
        numbers.flat_map(|index| (first + index as f32).to_le_bytes()).collect()
    };
    let mut tensors = BTreeMap::new();
    for (name, tensor) in state.tensors {
        let len = tensor.shape.iter().product::<usize>();
        let actor = name.strip_prefix("actor.").and_then(|parameter| actors.get(parameter));
        let bytes = match (name.as_str(), actor, tensor.dtype) {
            (_, Some(spec), _) => count(first, spec.range()),
            ("counters.iteration", ..) => iteration.to_le_bytes().into(),
            ("counters.env_steps", ..) => {
                (iteration * config.steps_per_iteration()).to_le_bytes().into()
            }
            ("counters.precision", ..) => 32_u64.to_le_bytes().into(),
            (_, _, Dtype::F32) => count(iteration as f32, 0..len),
            (_, _, Dtype::F64) => 0.5_f64.to_le_bytes().repeat(len),
            _ => iteration.to_le_bytes().repeat(len),
        };
        tensors.insert(name, (tensor.dtype, tensor.shape, bytes));
    }
    let mut digest = DigestBuilder::new();
    for (name, (_, _, bytes)) in &tensors {
        digest.field(name, bytes);
    }
    // Of moments that are one half everywhere.
    let moments = [("input.mean", 0.5_f32), ("input.inverse_std", (1.0_f32 + 1e-6).sqrt().recip())];
    for spec in &actors.tensors {
        let bytes = match moments.iter().find(|(name, _)| *name == spec.name) {
            Some((_, number)) => number.to_le_bytes().repeat(spec.range().len()),
            None => count(first, spec.range()),
        };
        let tensor = (Dtype::F32, spec.shape.clone(), bytes);
        tensors.insert(format!("policy.{}", spec.name), tensor);
    }
    let views = tensors.iter().map(|(name, (dtype, shape, bytes))| {
        (name.clone(), TensorView::new(*dtype, shape.clone(), bytes).expect("sized"))
    });
    let metadata = HashMap::from([("format".to_owned(), STATE_FORMAT.to_owned())]);
    let bytes = safetensors::serialize(views, Some(metadata)).expect("serialises");
    Snapshot { iteration, digest: digest.finish(), bytes }
}

fn commit_of(store: &CheckpointStore, config: &Config, snapshot: &Snapshot) -> std::path::PathBuf {
    let provenance = serde_json::json!({ "host": "a test" });
    store.commit(snapshot, config, &robot().to_toml(), &provenance).expect("commits")
}

/// Commits a small checkpoint.
fn commit(store: &CheckpointStore, iteration: u64) -> std::path::PathBuf {
    commit_of(store, &config(), &snapshot_of(&config(), iteration, 0.0))
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
