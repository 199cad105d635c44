//! An update against JAX and Optax: losses, gradients, advantages, normalisers, ten optimiser steps.
//!
//! The learner records an update on synthetic samples; `tests/crosscheck/learning.py` does the same
//! update by itself and compares. Python is `SPACEOCTOPUS_TEST_PYTHON`, or that of the tests' virtual
//! environment, which `make test` sets up.

use proto::agents::Joints;
use std::path::{Path, PathBuf};
use std::process::Command;

use learner::Update as _;
use learner::maddpg::{Maddpg, MaddpgTrace};
use learner::mappo::{Mappo, MappoTrace};
use learner::network::NetworkSpec;
use learner::precision::Arithmetic;
use learner::state::TrainingState;
use proto::config::{Config, Layers, Preset, TaskName};
use proto::layout::{BlockLayout, Dimensions};
use safetensors::{Dtype, tensor::TensorView};
use tch::{Device, Kind, Tensor};

/// Named arrays for Python.
#[derive(Default)]
struct Record(Vec<(String, Dtype, Vec<usize>, Vec<u8>)>);

impl Record {
    fn floats(&mut self, name: &str, shape: &[usize], data: &[f32]) {
        let bytes = data.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.0.push((name.to_owned(), Dtype::F32, shape.to_vec(), bytes));
    }

    fn tensor(&mut self, name: &str, tensor: &Tensor) {
        let shape: Vec<usize> = tensor.size().iter().map(|&n| n as usize).collect();
        let flat = tensor.to_kind(Kind::Float).contiguous().view([-1]);
        self.floats(name, &shape, &Vec::<f32>::try_from(flat).expect("f32"));
    }

    fn integers(&mut self, name: &str, data: &[i64]) {
        let bytes = data.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.0.push((name.to_owned(), Dtype::I64, vec![data.len()], bytes));
    }

    fn gradients(&mut self, step: usize, spec: &NetworkSpec, flat: &Tensor) {
        for parameter in &spec.parameters {
            let name = format!("gradient.{step}.{}.{}", spec.kind.as_str(), parameter.name);
            self.tensor(&name, &parameter.view(flat));
        }
    }

    fn write(&self, path: &Path) {
        let views = self.0.iter().map(|(name, dtype, shape, data)| {
            (name, TensorView::new(*dtype, shape.clone(), data).expect("bytes fit the shape"))
        });
        let bytes = safetensors::serialize(views, None).expect("valid names");
        std::fs::write(path, bytes).expect("a temporary file");
    }
}

fn python() -> PathBuf {
    match std::env::var_os("SPACEOCTOPUS_TEST_PYTHON") {
        Some(path) => path.into(),
        None => repository().join(".venv-tests/bin/python"),
    }
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Array `range` of all blocks, joined along `axis`, the environments'.
fn joined(blocks: &[Vec<f32>], range: &std::ops::Range<usize>, shape: &[i64], axis: i64) -> Tensor {
    let parts: Vec<Tensor> =
        blocks.iter().map(|b| Tensor::from_slice(&b[range.clone()]).view(shape)).collect();
    Tensor::cat(&parts, axis)
}

fn cross_check(assignments: &[&str]) {
    let config: Config = [
        "env.n_envs=16",
        "env.n_shards=2",
        "task.episode_steps=8",
        "network.hidden=[24,16]",
        "network.critic_hidden=[]",
        "algorithm.max_kl=0",
        "network.activation=relu",
        "network.parameter_sharing=none",
        "algorithm.epochs=5",
        "algorithm.mini_batches=2",
        "run.learner_threads=1",
        "run.env_steps=1000",
    ]
    .iter()
    .chain(assignments)
    .fold(Layers::new(Preset::Tuned, Some(TaskName::Trajectory)), |layers, assignment| {
        layers.set(assignment).expect("well formed")
    })
    .resolve()
    .expect("valid");
    let dimensions = Dimensions::new(&config, Joints::of_sixes(2));
    let mut state = TrainingState::initial(&config, &dimensions, Arithmetic::F32, Device::Cpu);
    let mut mappo = Mappo::in_one_group(&config, &dimensions, &state);
    let layout = BlockLayout::new(&dimensions);
    let samples = |seed| {
        let mut blocks = learner::synthetic::blocks(&dimensions, seed);
        // One episode ends for good, another is cut, both in the middle.
        blocks[0][layout.terminated.start + 3 * dimensions.n_envs + 1] = 1.0;
        blocks[1][layout.truncated.start + 2 * dimensions.n_envs] = 1.0;
        blocks
    };

    // The first update fills moments and normalisers; the second one is checked.
    let first = samples(1);
    let shards: Vec<&[f32]> = first.iter().map(Vec::as_slice).collect();
    mappo.update(&mut state, &shards).expect("finite");
    let before = state.to_safetensors();
    let blocks = samples(2);
    let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
    let mut trace = MappoTrace::default();
    mappo.update_traced(&mut state, &shards, Some(&mut trace)).expect("finite");
    assert_eq!(trace.gradients.len(), 10);

    let [a, t, n, o, s] = [
        dimensions.n_agents,
        dimensions.n_steps,
        dimensions.n_envs,
        dimensions.observation,
        dimensions.state,
    ]
    .map(|size| size as i64);
    let mut record = Record::default();
    let arrays: [(&str, _, &[i64], i64); 7] = [
        ("observation", &layout.observation, &[a, t + 1, n, o], 2),
        ("state", &layout.state, &[t + 1, n, s], 1),
        ("action", &layout.action, &[a, t, n, 3], 2),
        ("log_prob", &layout.log_prob, &[a, t, n], 2),
        ("reward", &layout.reward, &[a, t, n], 2),
        ("terminated", &layout.terminated, &[t, n], 1),
        ("truncated", &layout.truncated, &[t, n], 1),
    ];
    for (name, range, shape, axis) in arrays {
        record.tensor(name, &joined(&blocks, range, shape, axis));
    }
    let computed =
        [("value", &trace.value), ("advantage", &trace.advantage), ("returns", &trace.returns)];
    for (name, tensor) in computed {
        record.tensor(name, tensor.as_ref().expect("recorded"));
    }
    for step in 0..trace.gradients.len() {
        let (actor, critic) = &trace.gradients[step];
        record.gradients(step, &state.actor.spec, actor);
        record.gradients(step, &state.critic.spec, critic);
        record.integers(&format!("rows.{step}"), &trace.rows[step]);
        let (policy, value) = &trace.losses[step];
        for (kind, losses) in [("actor", policy), ("critic", value)] {
            let losses: Vec<f32> = losses.iter().map(|&x| x as f32).collect();
            record.floats(&format!("loss.{step}.{kind}"), &[losses.len()], &losses);
        }
    }

    compare("learning.py", &config, &before, &state, &record);
}

/// Writes everything down and has a script of `tests/crosscheck` compare it.
fn compare(script: &str, config: &Config, before: &[u8], after: &TrainingState, record: &Record) {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = |name: &str| directory.path().join(name);
    std::fs::write(path("config.toml"), config.to_toml()).expect("config");
    std::fs::write(path("before.safetensors"), before).expect("before");
    std::fs::write(path("after.safetensors"), after.to_safetensors()).expect("after");
    record.write(&path("record.safetensors"));
    let python = python();
    let output = Command::new(&python)
        .arg(repository().join("tests/crosscheck").join(script))
        .arg(directory.path())
        .env("JAX_PLATFORMS", "cpu")
        // Every operation is run a few times alone: compiling it takes longest.
        .env("XLA_FLAGS", "--xla_backend_optimization_level=0")
        .output()
        .unwrap_or_else(|error| {
            panic!("{}: {error}; `make test` sets up the tests' Python", python.display())
        });
    assert!(
        output.status.success(),
        "{}\n{}{}",
        config.to_toml(),
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
}

/// Two iterations; the updates of the second one are checked.
fn cross_check_maddpg(assignments: &[&str]) {
    let config: Config = [
        "algorithm.name=maddpg",
        "env.n_envs=16",
        "env.n_shards=2",
        "task.episode_steps=8",
        "network.hidden=[24,16]",
        "network.critic_hidden=[]",
        "algorithm.max_kl=0",
        "algorithm.maddpg.batch_size=48",
        "algorithm.maddpg.learning_starts=64",
        "algorithm.maddpg.updates_per_step=0.0625",
        "algorithm.maddpg.replay_steps=160",
        "algorithm.maddpg.soft_update=0.1",
        "run.learner_threads=1",
        "run.env_steps=1000",
    ]
    .iter()
    .chain(assignments)
    .fold(Layers::new(Preset::Tuned, Some(TaskName::Trajectory)), |layers, assignment| {
        layers.set(assignment).expect("well formed")
    })
    .resolve()
    .expect("valid");
    let dimensions = Dimensions::new(&config, Joints::of_sixes(2));
    let mut state = TrainingState::initial(&config, &dimensions, Arithmetic::F32, Device::Cpu);
    let mut maddpg = Maddpg::new(&config, &dimensions, &state);
    let layout = BlockLayout::new(&dimensions);
    let mut update = |state: &mut TrainingState, seed, trace| {
        let mut blocks = learner::synthetic::blocks(&dimensions, seed);
        // One episode ends for good, another is cut, both in the middle.
        blocks[0][layout.terminated.start + 3 * dimensions.n_envs + 1] = 1.0;
        blocks[1][layout.truncated.start + 2 * dimensions.n_envs] = 1.0;
        let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
        maddpg.update_traced(state, &shards, trace).expect("finite");
    };
    update(&mut state, 1, None);
    let before = state.to_safetensors();
    let mut trace = MaddpgTrace::default();
    update(&mut state, 2, Some(&mut trace));
    assert_eq!(trace.rows.len(), 8);

    let mut record = Record::default();
    for step in 0..trace.rows.len() {
        let (actor, critic) = &trace.gradients[step];
        record.gradients(step, &state.actor.spec, actor);
        record.gradients(step, &state.critic.spec, critic);
        record.integers(&format!("rows.{step}"), &trace.rows[step]);
        record.tensor(&format!("target.{step}"), &trace.targets[step]);
        let (policy, value) = &trace.losses[step];
        for (kind, losses) in [("actor", policy), ("critic", value)] {
            let losses: Vec<f32> = losses.iter().map(|&x| x as f32).collect();
            record.floats(&format!("loss.{step}.{kind}"), &[losses.len()], &losses);
        }
    }
    compare("maddpg.py", &config, &before, &state, &record);
}

#[test]
fn the_tuned_preset() {
    cross_check(&[]);
}

#[test]
fn a_dual_clip() {
    cross_check(&["algorithm.dual_clip=1.21"]);
}

#[test]
fn layer_norm_elu_entropy_and_the_released_multiplier() {
    cross_check(&[
        "network.layer_norm=true",
        "network.input_norm=layer_norm",
        "network.activation=elu",
        "network.critic_state=concatenated",
        "algorithm.entropy_coefficient=0.05",
        "algorithm.surrogate_multiplier=3",
        "algorithm.bootstrap_truncated=false",
        "algorithm.max_grad_norm=0.5",
        "optimizer.schedule=constant",
    ]);
}

#[test]
fn independent_learners_with_tanh_and_a_floor_under_the_deviation() {
    cross_check(&[
        "algorithm.name=ippo",
        "network.critic_state=own",
        "algorithm.name=ippo",
        "network.input_norm=none",
        "network.activation=tanh",
        "network.squash_mean=false",
        "network.initial_log_std=-0.7",
        "network.min_log_std=-0.7",
        "algorithm.entropy_coefficient=0.01",
        "algorithm.huber_delta=0.5",
        "algorithm.value_norm=false",
        "algorithm.normalize_advantage=false",
        "algorithm.max_grad_norm=0",
    ]);
}

#[test]
fn one_actor_for_all_agents() {
    cross_check(&["algorithm.name=ppo"]);
    cross_check(&[
        "algorithm.name=ppo",
        "network.layer_norm=true",
        "network.input_norm=layer_norm",
        "algorithm.entropy_coefficient=0.01",
        "algorithm.surrogate_multiplier=12",
    ]);
}

#[test]
fn a_shared_network() {
    cross_check(&["network.parameter_sharing=all", "algorithm.max_grad_norm=0.3"]);
}

#[test]
fn a_shared_network_with_layer_norm_and_no_value_clipping() {
    cross_check(&[
        "network.parameter_sharing=all",
        "network.layer_norm=true",
        "network.input_norm=layer_norm",
        "algorithm.value_clip=0",
        "algorithm.huber_delta=0",
    ]);
}

#[test]
fn a_network_for_each_role() {
    cross_check(&["network.parameter_sharing=roles", "algorithm.max_grad_norm=0.3"]);
    cross_check(&[
        "network.parameter_sharing=roles",
        "algorithm.name=ippo",
        "network.input_norm=layer_norm",
    ]);
}

#[test]
fn a_critic_for_each_role_with_an_output_for_each_agent() {
    let shared = "network.shared_critics=true";
    cross_check(&["network.parameter_sharing=roles", shared]);
    cross_check(&["network.parameter_sharing=all", shared, "algorithm.max_grad_norm=0.3"]);
}

#[test]
fn deterministic_actors_with_the_tuned_preset() {
    cross_check_maddpg(&[]);
}

#[test]
fn deterministic_actors_with_layer_norm_a_limit_and_clipped_gradients() {
    cross_check_maddpg(&[
        "network.layer_norm=true",
        "network.input_norm=layer_norm",
        "network.activation=elu",
        "network.critic_state=concatenated",
        "algorithm.bootstrap_truncated=false",
        "algorithm.maddpg.action_limit=2.5",
        "algorithm.max_grad_norm=0.5",
        "optimizer.schedule=constant",
    ]);
}

#[test]
fn deterministic_actors_as_the_authors_have_them() {
    cross_check_maddpg(&[
        "network.input_norm=none",
        "network.critic_state=concatenated",
        "network.hidden=[16,16,16]",
        "network.critic_hidden=[]",
        "algorithm.max_kl=0",
        "algorithm.gamma=0.95",
        "algorithm.maddpg.action_limit=10",
        "algorithm.max_grad_norm=0",
        "optimizer.actor_lr=1e-4",
        "optimizer.critic_lr=1e-3",
        "optimizer.schedule=constant",
        "optimizer.epsilon=1e-8",
    ]);
}
