//! What several fuzz targets need: a place for files, a small valid checkpoint, seeds.
//!
//! Every target writes its own seeds: run as `TARGET --seeds DIR` it fills the directory with valid
//! inputs and ends, so that none of them grows stale. Beside them `corpus/TARGET` keeps inputs that are
//! not valid, of kinds that once were answered wrongly, under names that say what is wrong with them.

use proto::agents::Joints;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use proto::config::{Config, Layers, Preset};
use proto::layout::{ActorLayout, Dimensions};
use proto::{Digest, DigestBuilder};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::{Value, json};
use store::checkpoint::{CheckpointStore, STATE_FORMAT, StateLayout};

/// A directory of this process for files. `make fuzz` puts it into memory by `TMPDIR` and removes
/// it, because libFuzzer ends processes without unwinding.
pub fn scratch() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| {
        let path = std::env::temp_dir().join(format!("octopus-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("temporary files can be written");
        path
    })
}

/// Fills the directory after `--seeds` on the command line and ends the process, if it is there.
pub fn write_seeds(seeds: impl FnOnce() -> Vec<Vec<u8>>) {
    let mut arguments = std::env::args().skip_while(|argument| argument != "--seeds").skip(1);
    let Some(directory) = arguments.next() else { return };
    std::fs::create_dir_all(&directory).expect("the seed directory can be made");
    for (index, seed) in seeds().iter().enumerate() {
        std::fs::write(Path::new(&directory).join(format!("seed-{index}")), seed)
            .expect("the seed directory can be written");
    }
    let _ = std::fs::remove_dir_all(scratch());
    std::process::exit(0);
}

/// A configuration with networks of a few numbers.
pub fn small_config() -> Config {
    let sets = [
        "env.n_envs=2",
        "env.n_shards=1",
        "task.episode_steps=2",
        "network.hidden=[2]",
        "algorithm.mini_batches=1",
    ];
    sets.iter()
        .try_fold(Layers::new(Preset::Tuned, None), |layers, set| layers.set(set))
        .and_then(|layers| layers.resolve())
        .expect("a valid configuration")
}

/// A robot as a checkpoint holds it.
pub fn robot_toml() -> String {
    simulator::robot::Robot::builtin("paper").expect("built in").to_toml()
}

/// The place of the actors' parameters under [`small_config`].
pub fn layout() -> ActorLayout {
    let config = small_config();
    ActorLayout::new(&config, &Dimensions::new(&config, Joints::of_sixes(4)))
}

/// Half of one, of which all actors and moments are made.
const HALF: f32 = 0.5;

/// Actors as safetensors, their names after `prefix`, and `more` tensors of one number.
pub fn tensors(prefix: &str, more: &[&str]) -> Vec<u8> {
    let layout = layout();
    let halves = HALF.to_le_bytes().repeat(layout.len);
    // What the learner publishes of moments that are one half everywhere.
    let inverse_std = (1.0_f32 + 1e-6).sqrt().recip().to_le_bytes().repeat(layout.len);
    let view = |numbers: &'static [u8], shape: Vec<usize>| {
        let bytes = &numbers[..4 * shape.iter().product::<usize>()];
        TensorView::new(Dtype::F32, shape, bytes).expect("as long as its shape says")
    };
    let (halves, inverse_std) = (&*halves.leak(), &*inverse_std.leak());
    let actors = layout.tensors.iter().map(|spec| {
        let numbers = if spec.name == "input.inverse_std" { inverse_std } else { halves };
        (format!("{prefix}{}", spec.name), view(numbers, spec.shape.to_vec()))
    });
    let more = more.iter().map(|name| ((*name).to_owned(), view(halves, vec![1])));
    safetensors::serialize(actors.chain(more), None).expect("well formed")
}

/// A training state after one iteration, with the actors of [`tensors`].
pub fn state() -> Vec<u8> {
    let config = small_config();
    let layout = StateLayout::new(&config, &Dimensions::new(&config, Joints::of_sixes(4)));
    let bytes = |name: &str, dtype, len: usize| match (name, dtype) {
        ("counters.env_steps", _) => config.steps_per_iteration().to_le_bytes().to_vec(),
        ("counters.precision", _) => 32_u64.to_le_bytes().to_vec(),
        (_, Dtype::F32) => HALF.to_le_bytes().repeat(len),
        (_, Dtype::F64) => f64::from(HALF).to_le_bytes().repeat(len),
        _ => 1_u64.to_le_bytes().repeat(len),
    };
    let tensors: Vec<_> = layout
        .tensors
        .into_iter()
        .map(|(name, tensor)| {
            let bytes = bytes(&name, tensor.dtype, tensor.shape.iter().product());
            (name, tensor.dtype, tensor.shape, bytes)
        })
        .collect();
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        let view = TensorView::new(*dtype, shape.clone(), bytes);
        (name.clone(), view.expect("as long as its shape says"))
    });
    let format = [("format".to_owned(), STATE_FORMAT.to_owned())];
    safetensors::serialize(views, Some(format.into())).expect("well formed")
}

/// A manifest that lists `files` with their true lengths and hashes, and their true digest if they
/// are readable.
pub fn manifest(files: &[(&str, &[u8])]) -> Value {
    let entries = files.iter().map(|(name, bytes)| {
        let hash = blake3::hash(bytes).to_hex().to_string();
        ((*name).to_owned(), json!({ "len": bytes.len(), "blake3": hash }))
    });
    let content = |wanted| files.iter().find(|(name, _)| *name == wanted).map(|(_, bytes)| *bytes);
    let described = content("state.safetensors").or(content("policy.safetensors"));
    json!({
        "format": 1,
        "iteration": 1,
        "env_steps": 4,
        "digest": digest(described.unwrap_or_default()).to_string(),
        "created_unix_s": 1_767_225_600,
        "provenance": {},
        "files": entries.collect::<serde_json::Map<_, _>>(),
    })
}

/// The digest of a safetensors file; of what is none, that of nothing.
fn digest(bytes: &[u8]) -> Digest {
    let mut tensors =
        SafeTensors::deserialize(bytes).map(|file| file.tensors()).unwrap_or_default();
    tensors.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut digest = DigestBuilder::new();
    for (name, view) in tensors {
        digest.field(&name, view.data());
    }
    digest.finish()
}

/// A store in the scratch directory, empty.
pub fn empty_store(name: &str) -> CheckpointStore {
    let root = scratch().join(name);
    let _ = std::fs::remove_dir_all(&root);
    std::fs::create_dir_all(&root).expect("temporary files can be written");
    CheckpointStore::new(root)
}
