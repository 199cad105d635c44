//! One policy set from the agents of several checkpoints.

use std::collections::BTreeMap;

use proto::config::{Config, InputNorm, JointAngles, Observation};
use proto::layout::{AGENTS_PER_ARM, ActorLayout, Dimensions};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};

use super::commit::Clash;
use super::entry::Entry;
use super::file_names::{CONFIG, FORMAT, POLICY, ROBOT};
use super::manifest::{Manifest, Origin};
use super::name::Name;
use super::parts::{Part, Parts};
use super::store::{CheckpointStore, now};
use super::{CheckpointError, tensors};

/// A policy set that is not committed yet.
#[derive(Debug, Clone)]
pub struct Composition {
    config: Config,
    robot_toml: String,
    policy: Vec<u8>,
    iteration: u64,
    env_steps: u64,
    origins: Vec<Origin>,
    /// Keys of `task` and `env` in which the parts differ; the first part's values are taken.
    pub notes: Vec<String>,
}

impl Composition {
    /// Takes the agents of each part's arms. The parts must have the same robot, and be alike in everything that a policy
    /// depends on.
    pub fn new(parts: &Parts) -> Result<Self, CheckpointError> {
        let refuse = |reason: String| Err(CheckpointError::Refused { reason });
        let (parts, robot) = (parts.parts(), parts.robot());
        let first = &parts[0];
        let first_checkpoint = &first.checkpoint;
        let dimensions = Dimensions::new(&first_checkpoint.config, robot.joints);
        if dimensions.n_actors != dimensions.n_agents {
            return refuse(format!(
                "{} has one actor for all arms (algorithm.name = {}), which cannot be taken apart",
                first.describe(),
                first_checkpoint.config.algorithm.name.as_str()
            ));
        }
        for part in &parts[1..] {
            compatible(first, part)?;
        }
        let config = first_checkpoint.config.clone();
        let layout = ActorLayout::new(&config, &dimensions);
        let mut flat = vec![0.0; layout.len];
        let mut origins = Vec::new();
        for part in parts {
            let actors = part.checkpoint.actors(robot.joints)?;
            if actors.len() != layout.len {
                return refuse(format!(
                    "{} has {} parameters of actors, {} has {}; they must be equal",
                    part.describe(),
                    actors.len(),
                    first.describe(),
                    layout.len
                ));
            }
            let agents = part.arms.iter().flat_map(|arm| {
                let first = arm * AGENTS_PER_ARM;
                first..first + AGENTS_PER_ARM
            });
            for agent in agents {
                for tensor in &layout.tensors {
                    let len = tensor.len() / tensor.shape[0];
                    let row = tensor.offset + agent * len..tensor.offset + (agent + 1) * len;
                    flat[row.clone()].copy_from_slice(&actors[row]);
                }
                let manifest = &part.checkpoint.manifest;
                origins.push(Origin {
                    agent,
                    digest: manifest.digest,
                    iteration: manifest.iteration,
                    run: part.checkpoint.dir.display().to_string(),
                    source_agent: agent,
                });
            }
        }
        origins.sort_by_key(|origin| origin.agent);
        let most = |count: fn(&Manifest) -> u64| {
            parts.iter().map(|part| count(&part.checkpoint.manifest)).max().unwrap_or(0)
        };
        Ok(Self {
            policy: serialize(&layout, &flat)?,
            robot_toml: first_checkpoint.robot_toml.clone(),
            iteration: most(|manifest| manifest.iteration),
            env_steps: most(|manifest| manifest.env_steps),
            origins,
            notes: notes(parts),
            config,
        })
    }
}

impl CheckpointStore {
    /// Commits a composition as a checkpoint without training state. The same one twice is no error.
    pub fn compose(
        &self,
        name: &Name,
        composition: &Composition,
        provenance: &serde_json::Value,
    ) -> Result<Entry, CheckpointError> {
        if name.iteration().is_some() {
            let reason = format!("`{name}` is a name for a run's own checkpoints; choose another");
            return Err(CheckpointError::refused(reason));
        }
        let Composition { config, robot_toml, policy, iteration, env_steps, origins, .. } =
            composition;
        let file = SafeTensors::deserialize(policy).expect("written by `serialize`");
        let manifest = Manifest {
            format: FORMAT,
            iteration: *iteration,
            env_steps: *env_steps,
            digest: tensors::digest(&file),
            created_unix_s: now(),
            provenance: provenance.clone(),
            files: BTreeMap::new(),
            origins: origins.clone(),
        };
        let config_toml = config.to_toml();
        let contents: [(&str, &[u8]); 3] =
            [(POLICY, policy), (CONFIG, config_toml.as_bytes()), (ROBOT, robot_toml.as_bytes())];
        self.write(name, Clash::Refuse, None, &contents, manifest)?;
        self.entry(name)
    }
}

/// The actors as the bytes of a safetensors file.
fn serialize(layout: &ActorLayout, flat: &[f32]) -> Result<Vec<u8>, CheckpointError> {
    let views: Result<Vec<_>, _> = layout
        .tensors
        .iter()
        .map(|spec| {
            let bytes = bytemuck::cast_slice(&flat[spec.range()]);
            let view = TensorView::new(Dtype::F32, spec.shape.clone(), bytes)?;
            Ok((spec.name.clone(), view))
        })
        .collect();
    views
        .and_then(|views| safetensors::serialize(views, None))
        .map_err(|error: safetensors::SafeTensorError| CheckpointError::refused(error.to_string()))
}

/// Refuses two parts whose policies do not act in the same world, or are not of the same kind.
fn compatible(one: &Part, other: &Part) -> Result<(), CheckpointError> {
    let refuse = |reason: String| Err(CheckpointError::Refused { reason });
    let (a, b) = (one.describe(), other.describe());
    let (left, right) = (&one.checkpoint.config, &other.checkpoint.config);
    let tasks = (left.task.name.as_str(), right.task.name.as_str());
    if tasks.0 != tasks.1 {
        return refuse(format!(
            "{a} learned `{}`, {b} learned `{}`: their agents see different numbers, so policies of \
             different tasks cannot be mixed",
            tasks.0, tasks.1
        ));
    }
    if !same_robot(&one.checkpoint.robot_toml, &other.checkpoint.robot_toml) {
        return refuse(format!("{a} and {b} move different robots; compare their {ROBOT}"));
    }
    for (key, value) in DEPENDENCIES {
        let (x, y) = (value(left), value(right));
        if x != y {
            return refuse(format!("{a} has {key} = {x}, {b} has {key} = {y}; they must be equal"));
        }
    }
    Ok(())
}

/// A configuration key and how its value is written.
type Dependency = (&'static str, fn(&Config) -> String);

/// Everything of a configuration that the meaning of a policy's numbers depends on, besides the
/// task: what it sees, what its actions do, and how its network computes.
const DEPENDENCIES: [Dependency; 17] = [
    // What an actor sees and moves, and what becomes of its output.
    ("the kind of actor", |c| c.algorithm.name.actor().to_owned()),
    ("algorithm.maddpg.action_limit", |c| {
        if c.algorithm.name.is_stochastic() {
            "unused".to_owned()
        } else {
            c.algorithm.maddpg.action_limit.to_string()
        }
    }),
    ("task.observation", |c| format!("{:?}", c.task.observation).to_lowercase()),
    ("task.joint_angles", |c| match (c.task.observation, c.task.joint_angles) {
        (Observation::Arm, JointAngles::SinCos) => "sin-cos".to_owned(),
        (Observation::Arm, JointAngles::Unwound) => "unwound".to_owned(),
        (Observation::Paper | Observation::Release, _) => "unused".to_owned(),
    }),
    ("task.posture.seen", |c| c.task.posture.seen.to_string()),
    // What is done beside it, or none of it.
    ("task.posture.gain", |c| c.task.posture.gain.to_string()),
    ("task.posture.fade", |c| c.task.posture.fades().unwrap_or(0.0).to_string()),
    ("task.posture.trust", |c| {
        if c.task.posture.seen { c.task.posture.trust.to_string() } else { "unused".to_owned() }
    }),
    ("task.action_scale", |c| c.task.action_scale.to_string()),
    ("env.control_period", |c| c.env.control_period.to_string()),
    ("network.hidden", |c| format!("{:?}", c.network.hidden)),
    ("network.activation", |c| format!("{:?}", c.network.activation).to_lowercase()),
    ("network.layer_norm", |c| c.network.layer_norm.to_string()),
    ("network.input_norm", |c| format!("{:?}", c.network.input_norm)),
    // Without a running normalisation nothing is clipped.
    ("network.input_clip", |c| match c.network.input_norm {
        InputNorm::Running => c.network.input_clip.to_string(),
        InputNorm::None | InputNorm::LayerNorm => "unused".to_owned(),
    }),
    ("network.inference", |c| format!("{:?}", c.network.inference).to_lowercase()),
    ("network.squash_mean", |c| c.network.squash_mean.to_string()),
];

fn same_robot(one: &str, other: &str) -> bool {
    let table = |text: &str| toml::from_str::<toml::Table>(text);
    one == other || matches!((table(one), table(other)), (Ok(a), Ok(b)) if a == b)
}

/// Keys of `task` and `env` in which later parts differ from the first.
fn notes(parts: &[Part]) -> Vec<String> {
    let mut keys = Vec::new();
    for part in &parts[1..] {
        let flat = |part: &Part| super::compare::leaves(&part.checkpoint.config);
        let (first, other) = (flat(&parts[0]), flat(part));
        for (key, value) in &first {
            let matters = key.starts_with("task.") || key.starts_with("env.");
            if matters && other.get(key) != Some(value) && !keys.contains(key) {
                keys.push(key.clone());
            }
        }
    }
    keys
}
