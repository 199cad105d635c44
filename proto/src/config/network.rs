//! Group `network`: actors, critics and what goes into them.
//!
//! **Critics may be smaller than actors** (`critic_hidden`). They are half of an update. `trajectory` learns as
//! well with critics of 128 × 128; `reorientation` does not, and MADDPG's actors learn from nothing but the
//! critics' slopes, so preset `tuned` leaves those as wide as the actors.

use serde::{Deserialize, Serialize};

use crate::agents::AGENTS_PER_ARM;

/// The non-linearity of hidden layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// max(0, x).
    Relu,
    /// x for x > 0, eˣ − 1 otherwise.
    Elu,
    /// Hyperbolic tangent.
    Tanh,
}

/// What happens to observations before the first layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputNorm {
    /// Nothing.
    None,
    /// LayerNorm with learned gain and bias over the features of a sample.
    LayerNorm,
    /// Running mean and variance per feature, clipped at ± `input_clip`.
    Running,
}

/// Precision of the policies' products in workers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Inference {
    /// Single precision.
    F32,
    /// Hidden layers after the first multiply bfloat16 and sum in single precision: the same bits on every processor.
    Bf16,
}

/// What critics see.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CriticState {
    /// All agents' observations, one after the other.
    Concatenated,
    /// Every quantity of the environment once.
    Compact,
    /// What its actor sees: the agent's own observation (independent learners), or all of them
    /// (centralised PPO).
    Own,
}

/// Which agents are one network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ParameterSharing {
    /// Every agent has its own actor and critic.
    None,
    /// Agents of the same role, which move the same joints of different arms, are one actor; and one
    /// critic if critics see what actors see. A critic that sees the whole robot stays its agent's own:
    /// what it sees does not say whose arm is meant. But see `shared_critics`.
    Roles,
    /// All agents are one actor and one critic.
    All,
}

/// Group `network`. Actors and critics are multi-layer perceptrons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Network {
    /// Width of each hidden layer.
    pub hidden: Vec<usize>,
    /// Width of each hidden layer of critics; with `[]` those of actors.
    #[serde(default)]
    pub critic_hidden: Vec<usize>,
    /// Non-linearity.
    pub activation: Activation,
    /// LayerNorm after each hidden activation.
    pub layer_norm: bool,
    /// Treatment of the input.
    pub input_norm: InputNorm,
    /// Limit of running-normalised inputs, in standard deviations.
    pub input_clip: f64,
    /// Precision of the policies' products in workers.
    pub inference: Inference,
    /// What critics see.
    pub critic_state: CriticState,
    /// Which agents are one network, told apart by a learned first-layer bias an agent.
    pub parameter_sharing: ParameterSharing,
    /// Whether agents who are one actor have one critic, with an output for each, where critics see the whole robot (`mappo`):
    /// its layers are computed once for all of them, and learn from the returns of all.
    #[serde(default)]
    pub shared_critics: bool,
    /// Squashes the mean action with tanh.
    pub squash_mean: bool,
    /// Initial logarithm of the actions' standard deviation; of wrists' but for `wrist_log_std_offset`.
    pub initial_log_std: f64,
    /// What is added to it for the joints of wrists. Nothing with `parameter_sharing = "all"`, where one set of
    /// deviations is shoulders' and wrists'.
    #[serde(default)]
    pub wrist_log_std_offset: f64,
    /// Floor of the logarithm of the action's standard deviation.
    pub min_log_std: f64,
    /// Gain of the orthogonal initialisation of the action head.
    pub head_gain: f64,
}

impl Network {
    /// Initial logarithm of the standard deviation of `agent`'s actions, also where one actor acts for all. Each
    /// arm's second agent is its wrist.
    pub fn initial_log_std_of(&self, agent: usize) -> f64 {
        let apart = self.parameter_sharing != ParameterSharing::All;
        let is_wrist = agent % AGENTS_PER_ARM == 1;
        self.initial_log_std + if apart && is_wrist { self.wrist_log_std_offset } else { 0.0 }
    }

    /// Networks of `n_actors` actors that differ in more than the bias of their first layer.
    pub fn actor_networks(&self, n_actors: usize) -> usize {
        match self.parameter_sharing {
            ParameterSharing::All => 1,
            ParameterSharing::Roles => AGENTS_PER_ARM.min(n_actors),
            ParameterSharing::None => n_actors,
        }
    }

    /// Width of each hidden layer of critics.
    pub fn hidden_of_critics(&self) -> &[usize] {
        if self.critic_hidden.is_empty() { &self.hidden } else { &self.critic_hidden }
    }
}
