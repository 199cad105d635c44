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

use super::fixtures::snapshot_of;
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
