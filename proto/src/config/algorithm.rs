//! Group `algorithm`: MAPPO and its relatives.

use serde::{Deserialize, Serialize};

use super::maddpg::Maddpg;

/// The learning algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlgorithmName {
    /// Multi-agent PPO with centralised critics (Yu et al. 2022).
    Mappo,
    /// Independent PPO: each critic sees its own agent's observation only.
    Ippo,
    /// Centralised PPO (Schulman et al. 2017): one actor and one critic, which see all agents'
    /// observations one after the other and are paid the sum of all rewards.
    Ppo,
    /// Multi-agent deep deterministic policy gradient (Lowe et al. 2017): deterministic actors, critics
    /// that see everything and all actions, and a replay.
    Maddpg,
}

impl AlgorithmName {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Mappo, Self::Ippo, Self::Ppo, Self::Maddpg];

    /// Whether actors give the parameters of a distribution that actions are drawn from.
    pub fn is_stochastic(self) -> bool {
        match self {
            Self::Mappo | Self::Ippo | Self::Ppo => true,
            Self::Maddpg => false,
        }
    }

    /// What kind of actor it trains: policies of one kind are exchangeable.
    pub fn actor(self) -> &'static str {
        match self {
            Self::Mappo | Self::Ippo => "stochastic, one an agent",
            Self::Ppo => "stochastic, one for all agents",
            Self::Maddpg => "deterministic, one an agent",
        }
    }

    /// The name as it is written in configurations and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Mappo => "mappo",
            Self::Ippo => "ippo",
            Self::Ppo => "ppo",
            Self::Maddpg => "maddpg",
        }
    }
}

/// Group `algorithm`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Algorithm {
    /// Which algorithm.
    pub name: AlgorithmName,
    /// Discount γ per control step.
    pub gamma: f64,
    /// λ of generalised advantage estimation (Schulman et al. 2016).
    pub gae_lambda: f64,
    /// Clip range of the probability ratio.
    pub clip: f64,
    /// Where the advantage is negative, a ratio beyond this moves nothing either (dual clip); 0 turns that off.
    #[serde(default)]
    pub dual_clip: f64,
    /// Clip range of the value prediction around the old one; 0 turns value clipping off.
    pub value_clip: f64,
    /// Passes over the samples of an iteration.
    pub epochs: usize,
    /// Parts that each pass is split into, one optimiser step each.
    pub mini_batches: usize,
    /// Weight of the entropy bonus.
    pub entropy_coefficient: f64,
    /// Weight of the value loss.
    pub value_coefficient: f64,
    /// δ of the Huber value loss; 0 means the plain squared error.
    pub huber_delta: f64,
    /// Normalises value targets by running moments (ValueNorm of Yu et al. 2022).
    pub value_norm: bool,
    /// Decay β of the moments of the value normaliser.
    pub value_norm_beta: f64,
    /// Standardises advantages, per agent, over the samples of an iteration.
    pub normalize_advantage: bool,
    /// Factor on the surrogate; the released code's broadcasting makes it 3.
    pub surrogate_multiplier: f64,
    /// Bootstraps with the value of the last observation where an episode was cut by time.
    pub bootstrap_truncated: bool,
    /// Limit of the gradient's global norm, actor and critic apart, per agent; 0 turns it off.
    pub max_grad_norm: f64,
    /// Ends an iteration's steps of an actor when its KL divergence passes this, the mean over its agents; the critic goes on. 0 turns it off. With `run.overlap` the divergence holds the update before, too.
    pub max_kl: f64,
    /// What only MADDPG uses. Of the keys above it uses `gamma`, `bootstrap_truncated` and
    /// `max_grad_norm`. Configurations from before MADDPG go on without.
    #[serde(default)]
    pub maddpg: Maddpg,
}
