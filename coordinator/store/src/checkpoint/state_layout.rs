//! What a training state holds: names, types and shapes of its tensors, and which numbers make sense in them.
//!
//! The learner writes training states and restores nothing else (`learner/src/state.rs`, where the
//! names are explained). Here the same follows from the configuration without libtorch, so that a
//! state from outside is judged before a learner dies of it. A test of the whole program holds the
//! two together: `octopus checkpoints verify` finds no problem in what learners have written.

use std::collections::BTreeMap;

use proto::config::{AlgorithmName, Config, CriticState, InputNorm};
use proto::layout::{ActorLayout, Dimensions};
use safetensors::Dtype;

/// The `format` entry of a state's metadata.
pub const STATE_FORMAT: &str = "spaceoctopus training state 1";

/// The published running mean of the input.
pub(super) const MEAN: &str = "input.mean";
/// The published inverse of its standard deviation.
pub(super) const INVERSE_STD: &str = "input.inverse_std";

/// Which numbers make sense in a tensor; finite they are everywhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Numbers {
    /// Any.
    Any,
    /// Any, but not zeros alone: a network of zeros learns nothing and never was initialised.
    Weights,
    /// Zero and more: counts and mean squares.
    NotNegative,
    /// From zero to one.
    Share,
}

/// Type, shape and range of a tensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateTensor {
    /// Its type.
    pub dtype: Dtype,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its range.
    pub(super) numbers: Numbers,
}

/// The tensors of a training state by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateLayout {
    /// In alphabetical order.
    pub tensors: BTreeMap<String, StateTensor>,
}

impl StateLayout {
    /// The tensors that follow from a configuration.
    pub fn new(config: &Config, dimensions: &Dimensions) -> Self {
        let mut layout = Self { tensors: BTreeMap::new() };
        let rows = dimensions.n_actors;
        let maddpg = config.algorithm.name == AlgorithmName::Maddpg;
        for (network, networks, parameters) in [
            ("actor", rows, actors(config, dimensions)),
            ("critic", config.critics(rows), critics(config, dimensions)),
        ] {
            for (parameter, shape) in parameters {
                let weights = parameter.starts_with("hidden.") && parameter.ends_with(".weight");
                let numbers = if weights { Numbers::Weights } else { Numbers::Any };
                let mut add = |prefix: &str, numbers| {
                    let name = format!("{prefix}{parameter}");
                    layout.add(&name, Dtype::F32, shape.clone(), numbers);
                };
                add(&format!("{network}."), numbers);
                add(&format!("{network}.adam.m."), Numbers::Any);
                add(&format!("{network}.adam.v."), Numbers::NotNegative);
                if maddpg {
                    add(&format!("target_{network}."), numbers);
                }
            }
            let steps = format!("{network}.adam.steps");
            layout.add(&steps, Dtype::I64, vec![networks], Numbers::NotNegative);
        }
        if config.optimizer.target_kl > 0.0 {
            layout.add("actor.rate", Dtype::F64, vec![rows], Numbers::NotNegative);
        }
        layout.add("value_norm.mean", Dtype::F64, vec![rows], Numbers::Any);
        layout.add("value_norm.mean_square", Dtype::F64, vec![rows], Numbers::NotNegative);
        layout.add("value_norm.debias", Dtype::F64, vec![rows], Numbers::Share);
        if config.network.input_norm == InputNorm::Running {
            let Dimensions { n_agents, observation, state, .. } = *dimensions;
            layout.add_moments("observation_norm", n_agents, observation);
            if config.network.critic_state != CriticState::Own {
                layout.add_moments("state_norm", 1, state);
            }
        }
        if maddpg {
            layout.add_replay(config, dimensions);
        }
        let published = ActorLayout::new(config, dimensions).len;
        layout.add("previous_policy", Dtype::F32, vec![published], Numbers::Any);
        for counter in ["iteration", "env_steps", "precision"] {
            layout.add(&format!("counters.{counter}"), Dtype::U64, vec![1], Numbers::Any);
        }
        layout
    }

    fn add(&mut self, name: &str, dtype: Dtype, shape: Vec<usize>, numbers: Numbers) {
        self.tensors.insert(name.to_owned(), StateTensor { dtype, shape, numbers });
    }

    fn add_moments(&mut self, name: &str, rows: usize, features: usize) {
        let shape = vec![rows, features];
        self.add(&format!("{name}.mean"), Dtype::F64, shape.clone(), Numbers::Any);
        self.add(&format!("{name}.m2"), Dtype::F64, shape, Numbers::NotNegative);
        self.add(&format!("{name}.count"), Dtype::F64, vec![1], Numbers::NotNegative);
    }

    fn add_replay(&mut self, config: &Config, dimensions: &Dimensions) {
        let Dimensions { n_agents: a, n_steps: t, n_actions: u, observation: o, state, .. } =
            *dimensions;
        let s = if config.network.critic_state == CriticState::Concatenated { 0 } else { state };
        let c = config.algorithm.maddpg.replay_steps / t;
        for (name, shape, numbers) in [
            ("observation", vec![c, t + 1, a * o], Numbers::Any),
            ("state", vec![c, t + 1, s], Numbers::Any),
            ("action", vec![c, t, a * u], Numbers::Any),
            ("reward", vec![c, t, a], Numbers::Any),
            ("future", vec![c, t], Numbers::Share),
        ] {
            self.add(&format!("replay.{name}"), Dtype::F32, shape, numbers);
        }
        self.add("replay.episodes", Dtype::U64, vec![1], Numbers::Any);
    }
}

/// Names and shapes of the actors' parameters: what is published, without running moments, which are
/// no parameters.
fn actors(config: &Config, dimensions: &Dimensions) -> Vec<(String, Vec<usize>)> {
    let published = ActorLayout::new(config, dimensions).tensors;
    let parameters = published.into_iter().filter(|tensor| !is_moment(&tensor.name));
    parameters.map(|tensor| (tensor.name, tensor.shape)).collect()
}

/// Whether a published tensor is a running moment of the input.
pub(super) fn is_moment(published: &str) -> bool {
    [MEAN, INVERSE_STD].contains(&published)
}

/// Names and shapes of the critics' parameters: one critic an actor, or one with an output for each of several.
fn critics(config: &Config, dimensions: &Dimensions) -> Vec<(String, Vec<usize>)> {
    let network = &config.network;
    let rows = config.critics(dimensions.n_actors);
    let values = dimensions.n_actors / rows;
    let mut width = dimensions.critic_input();
    let mut parameters = Vec::new();
    let mut add = |name: String, shape: Vec<usize>| parameters.push((name, shape));
    if network.input_norm == InputNorm::LayerNorm {
        add("input.gain".to_owned(), vec![rows, width]);
        add("input.bias".to_owned(), vec![rows, width]);
    }
    for (layer, &units) in network.hidden_of_critics().iter().enumerate() {
        add(format!("hidden.{layer}.weight"), vec![rows, width, units]);
        add(format!("hidden.{layer}.bias"), vec![rows, units]);
        if network.layer_norm {
            add(format!("hidden.{layer}.gain"), vec![rows, units]);
            add(format!("hidden.{layer}.shift"), vec![rows, units]);
        }
        width = units;
    }
    add("head.weight".to_owned(), vec![rows, width, values]);
    add("head.bias".to_owned(), vec![rows, values]);
    parameters
}
