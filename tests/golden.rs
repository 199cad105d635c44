//! Golden digests: what small rollouts, evaluations and trainings gave when they were recorded.
//!
//! A change that is not meant to change a bit is held against them, `make golden`; one that is meant to
//! records them anew, `make golden RECORD=1`, and says so in its commit.
//!
//! What the simulator computes has the same bits on every processor, so blocks and evaluations have one
//! digest each, whatever back end made them. Products of libtorch differ between types of processors, so
//! trainings have one for each type that they were recorded on; on another they are reported as unknown.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, Result, ensure};
use proto::config::{AlgorithmName, Config, Layers, Preset, TaskName};
use proto::layout::{ActorLayout, Dimensions};
use proto::rng::{Address, Purpose};
use proto::{Digest, DigestBuilder};
use serde::{Deserialize, Serialize};
use simulator::evaluate::Evaluation;
use simulator::executor::InOrder;
use simulator::experiment::{Player, Trial, play};
use simulator::robot::Robot;
use simulator::rollout::{RolloutSpec, World, rollout_on};
use simulator::scalar::Backend;
use store::checkpoint::read_policy;

use crate::Run;

/// Digests by what they are of, sorted.
pub type Digests = BTreeMap<String, String>;

/// The recorded file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Golden {
    /// Of blocks, the same on every processor.
    pub blocks: Digests,
    /// Of evaluations of the policies that come with the program, the same on every processor.
    pub evaluations: Digests,
    /// Of training states after [`ITERATIONS`], by type of processor.
    pub trainings: BTreeMap<String, Digests>,
}

/// Iterations of a golden training: the replay of MADDPG has its first updates in the second.
pub const ITERATIONS: u64 = 3;

const TASKS: [TaskName; 2] = [TaskName::Trajectory, TaskName::Reorientation];
const PRESETS: [Preset; 3] = [Preset::Tuned, Preset::Paper, Preset::Release];
/// Beside all combinations of these.
const MORE: [(Preset, TaskName); 3] = [
    (Preset::Guided, TaskName::Trajectory),
    (Preset::Guided, TaskName::Capture),
    (Preset::Tuned, TaskName::Mixed),
];
const ALGORITHMS: [AlgorithmName; 4] =
    [AlgorithmName::Mappo, AlgorithmName::Ippo, AlgorithmName::Ppo, AlgorithmName::Maddpg];
const BACKENDS: [Backend; 3] = [Backend::Portable, Backend::Avx2, Backend::Avx512];

impl Golden {
    /// Where the digests are recorded.
    pub fn path() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/digests.toml")
    }

    /// Reads what was recorded.
    pub fn read() -> Result<Self> {
        let path = Self::path();
        let text = std::fs::read_to_string(&path)
            .with_context(|| format!("{} cannot be read", path.display()))?;
        toml::from_str(&text).with_context(|| format!("{} is no record", path.display()))
    }

    /// Records.
    pub fn write(&self) -> Result<()> {
        let text = format!(
            "# Written by `make golden RECORD=1`; see tests/golden.rs.\n\n{}",
            toml::to_string(self)?
        );
        std::fs::write(Self::path(), text).context("the record cannot be written")
    }
}

/// What differs from the record, a line each; also what is not in it.
pub fn differences(recorded: &Digests, found: &Digests) -> Vec<String> {
    found
        .iter()
        .filter_map(|(what, digest)| match recorded.get(what) {
            Some(known) if known == digest => None,
            Some(known) => Some(format!("{what}: {digest}, recorded is {known}")),
            None => Some(format!("{what}: {digest}, nothing is recorded")),
        })
        .collect()
}

/// Blocks of both tasks, every preset and every algorithm, made by every back end of this processor, which
/// must agree. `n_envs` of a shard is 5, so that lanes are left over, and 20, more than a vector holds.
pub fn blocks() -> Result<Digests> {
    let mut digests = Digests::new();
    for (preset, task, algorithm) in combinations() {
        for envs in [5, 20] {
            let sets = [format!("env.n_envs={}", 2 * envs), "env.n_shards=2".to_owned()];
            let config = config(preset, task, algorithm, &sets)?;
            let what = format!("{} envs {envs}", name(preset, task, algorithm));
            let by_backend = BACKENDS
                .into_iter()
                .filter(|backend| backend.is_available())
                .map(|backend| Ok((backend, block(backend, &config)?)))
                .collect::<Result<Vec<_>>>()?;
            agree(&what, &by_backend)?;
            digests.insert(what, by_backend[0].1.to_string());
        }
    }
    Ok(digests)
}

/// Evaluations of the policies that come with the program, by every back end of this processor.
pub fn evaluations() -> Result<Digests> {
    let mut digests = Digests::new();
    for task in TASKS {
        let dir =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/policies").join(task.as_str());
        let text = std::fs::read_to_string(dir.join("config.toml"))?;
        let config = Layers::new(Preset::Tuned, None).text(&text, "the policy")?.resolve()?;
        let robot_path = dir.join("robot.toml");
        let robot = Robot::from_toml(&std::fs::read_to_string(&robot_path)?, &robot_path)?;
        let world = World::new(&config, &robot);
        let layout = ActorLayout::new(&config, &world.dimensions);
        let policy = world.policy(&read_policy(&dir.join("policy.safetensors"), &layout)?)?;
        let mut by_backend = Vec::new();
        for backend in BACKENDS.into_iter().filter(|backend| backend.is_available()) {
            let mut trial = Trial::new(Player::new(&world, &policy), 0, 20, 50);
            trial.backend = backend;
            let evaluation = Evaluation::of(&play(&trial, &InOrder, &|| ())?);
            let mut digest = DigestBuilder::new();
            digest.field("evaluation", &serde_json::to_vec(&evaluation)?);
            by_backend.push((backend, digest.finish()));
        }
        agree(task.as_str(), &by_backend)?;
        digests.insert(task.as_str().to_owned(), by_backend[0].1.to_string());
    }
    Ok(digests)
}

/// Trainings of the paper's tasks, presets without and with goal postures, other tasks, and every algorithm, with `overlap` 0 and 1, in single precision, and with preset
/// `tuned` in bfloat16, too; `few` of them, or all. `report` hears of each.
pub fn trainings(few: bool, report: &(dyn Fn(&str) + Sync)) -> Result<Digests> {
    let mut all = Vec::new();
    for (preset, task, algorithm) in combinations() {
        for precision in ["f32", "bf16"] {
            if precision == "bf16" && preset != Preset::Tuned {
                continue;
            }
            for overlap in [0, 1] {
                let first = preset == Preset::Tuned && task == TaskName::Trajectory;
                if !few || first && overlap == 0 {
                    all.push((preset, task, algorithm, precision, overlap));
                }
            }
        }
    }
    // A few at a time: a small run mostly waits for its processes to start.
    let next = AtomicUsize::new(0);
    let work = || {
        let mut digests = Digests::new();
        while let Some(&(preset, task, algorithm, precision, overlap)) =
            all.get(next.fetch_add(1, Ordering::Relaxed))
        {
            let what = format!("{} {precision} overlap {overlap}", name(preset, task, algorithm));
            report(&what);
            let digest = training(preset, task, algorithm, precision, overlap)?;
            digests.insert(what, digest);
        }
        anyhow::Ok(digests)
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..2).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_fold(Digests::new(), |mut all, thread| {
            all.extend(thread.join().expect("no panic")?);
            Ok(all)
        })
    })
}

/// The type of this processor, as far as it chooses libtorch's arithmetic: its maker, family and model.
pub fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |key: &str| {
        let line = text.lines().find(|line| line.split(':').next().map(str::trim) == Some(key));
        line.and_then(|line| line.split(':').nth(1)).map_or("unknown", str::trim)
    };
    format!("{} family {} model {}", field("vendor_id"), field("cpu family"), field("model"))
}

fn combinations() -> impl Iterator<Item = (Preset, TaskName, AlgorithmName)> {
    let all = PRESETS.into_iter().flat_map(|preset| {
        TASKS.into_iter().flat_map(move |task| {
            ALGORITHMS.into_iter().map(move |algorithm| (preset, task, algorithm))
        })
    });
    all.chain(MORE.map(|(preset, task)| (preset, task, AlgorithmName::Mappo)))
}

fn name(preset: Preset, task: TaskName, algorithm: AlgorithmName) -> String {
    format!("{} {} {}", preset.as_str(), task.as_str(), algorithm.as_str())
}

/// What makes any configuration small: eight steps, narrow networks.
const SMALL: [&str; 3] =
    ["task.episode_steps=8", "network.hidden=[16]", "network.critic_hidden=[16]"];

fn config(
    preset: Preset,
    task: TaskName,
    algorithm: AlgorithmName,
    sets: &[String],
) -> Result<Config> {
    let algorithm = format!("algorithm.name={}", algorithm.as_str());
    let mut layers = Layers::new(preset, Some(task)).set(&algorithm)?;
    for set in SMALL.iter().copied().chain(sets.iter().map(String::as_str)) {
        layers = layers.set(set)?;
    }
    Ok(layers.resolve()?)
}

/// Shard 1 of iteration 2, so that no part of the address is zero.
fn block(backend: Backend, config: &Config) -> Result<Digest> {
    let robot = Robot::builtin(&config.robot.description).context("a built-in robot")?;
    let world = World::new(config, &robot);
    let policy = world.policy(&parameters(config, &world.dimensions))?;
    let spec = RolloutSpec { seed: 7, iteration: 2, shard: 1, policy: &policy };
    let mut block = vec![0.0; world.block_layout().len];
    rollout_on(backend, &world, &spec, &mut block, &mut |_| ())?;
    let bytes: Vec<u8> = block.iter().flat_map(|x: &f32| x.to_le_bytes()).collect();
    Ok(DigestBuilder::new().field("block", &bytes).finish())
}

/// Parameters that make actions of about a tenth, all different.
fn parameters(config: &Config, dimensions: &Dimensions) -> Vec<f32> {
    let layout = ActorLayout::new(config, dimensions);
    let mut parameters = vec![0.0; layout.len];
    for (index, tensor) in layout.tensors.iter().enumerate() {
        let kind = tensor.name.rsplit('.').next().unwrap_or_default();
        let scale = 0.3 / (tensor.shape[1] as f32).sqrt();
        for (step, four) in parameters[tensor.range()].chunks_mut(4).enumerate() {
            let (iteration, step) = (index as u32, step as u32);
            let purpose = Purpose::Initialisation;
            let address = Address { seed: 3, purpose, iteration, env: 0, step, index: 0 };
            for (x, z) in four.iter_mut().zip(address.normals()) {
                *x = match kind {
                    "gain" | "inverse_std" => 1.0,
                    "log_std" => -1.0,
                    "weight" => z * scale * 3.0,
                    _ => z * 0.03,
                };
            }
        }
    }
    parameters
}

fn training(
    preset: Preset,
    task: TaskName,
    algorithm: AlgorithmName,
    precision: &str,
    overlap: usize,
) -> Result<String> {
    let mut run = Run::new();
    let mut flags = vec![
        format!("--preset={}", preset.as_str()),
        format!("--algorithm={}", algorithm.as_str()),
        format!("--iterations={ITERATIONS}"),
        format!("--set=run.precision={precision}"),
        format!("--overlap={overlap}"),
        "--workers=2".to_owned(),
        "--quiet".to_owned(),
    ];
    if algorithm == AlgorithmName::Maddpg {
        flags.extend(
            [
                "--set=algorithm.maddpg.learning_starts=128",
                "--set=algorithm.maddpg.updates_per_step=0.05",
                "--set=algorithm.maddpg.batch_size=64",
                "--set=algorithm.maddpg.replay_steps=400",
            ]
            .map(str::to_owned),
        );
    }
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    run.start_training_of(task.as_str(), &flags);
    run.succeed();
    let digests = run.digests();
    ensure!(
        digests.len() as u64 == ITERATIONS,
        "{} iterations; log:\n{}",
        digests.len(),
        run.log()
    );
    ensure!(digests[1] != digests[2], "training moves the parameters; log:\n{}", run.log());
    Ok(digests[2].clone())
}

fn agree(what: &str, by_backend: &[(Backend, Digest)]) -> Result<()> {
    let (first, digest) = by_backend[0];
    for (backend, other) in by_backend {
        ensure!(*other == digest, "{what}: {backend:?} gives {other}, {first:?} gives {digest}");
    }
    Ok(())
}
