//! The configuration of a run: typed sections, presets, layered merging and validation.
//!
//! A configuration is built in layers, each one overriding the last: the preset's table, the
//! preset's changes for the chosen task and algorithm (`[for.trajectory.…]`, `[for.ppo.…]`), the user's
//! file (and its changes for them), the command line's `--set key=value`. Every layer is checked against the preset, which holds every key that
//! exists, so a wrong key or type is reported with the layer it came from. The result is one typed
//! [`Config`] without options to resolve later; it is what every process reads, what a run
//! directory stores as `config.toml`, and what a checkpoint carries.
//!
//! ```
//! use proto::config::{Config, Layers, Preset, TaskName};
//!
//! let config = Layers::new(Preset::Tuned, Some(TaskName::Trajectory))
//!     .set("network.hidden=[64, 64]")?
//!     .resolve()?;
//! assert_eq!(config.network.hidden, [64, 64]);
//! # Ok::<(), proto::ConfigError>(())
//! ```

mod algorithm;
mod env;
mod layers;
mod maddpg;
mod network;
mod optimizer;
mod run;
mod task;
mod typed;
mod validation;

use serde::{Deserialize, Serialize};

pub use algorithm::{Algorithm, AlgorithmName};
pub use env::{Env, Integrator, RobotSection};
pub use layers::{Layers, Preset};
pub use maddpg::{Exploration, Maddpg};
pub use network::{Activation, CriticState, Inference, InputNorm, Network, ParameterSharing};
pub use optimizer::{Optimizer, Schedule};
pub use run::{Precision, Run};
pub use task::{GoalBox, JointAngles, Observation, Reward, RewardWeights, Start, Task, TaskName};

use crate::ConfigError;

/// Everything that determines a run. Two runs with equal configurations on the same build and
/// processor type end with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What is to be learned.
    pub task: Task,
    /// Who learns it.
    pub robot: RobotSection,
    /// How it is simulated.
    pub env: Env,
    /// The networks.
    pub network: Network,
    /// The learning algorithm.
    pub algorithm: Algorithm,
    /// Adam and its schedule.
    pub optimizer: Optimizer,
    /// Seeds, budgets, processes.
    pub run: Run,
}

impl Config {
    /// How workers explore in `iteration`, if actors are deterministic.
    pub fn exploration(&self, iteration: u64) -> Option<Exploration> {
        let steps = iteration.saturating_mul(self.steps_per_iteration());
        match self.algorithm.name {
            AlgorithmName::Mappo | AlgorithmName::Ippo | AlgorithmName::Ppo => None,
            AlgorithmName::Maddpg => Some(self.algorithm.maddpg.exploration(steps)),
        }
    }

    /// Env-steps that one iteration collects.
    pub fn steps_per_iteration(&self) -> u64 {
        (self.env.n_envs * self.task.episode_steps) as u64
    }

    /// Iterations that the budget plans, rounded up.
    pub fn planned_iterations(&self) -> u64 {
        self.run.env_steps.div_ceil(self.steps_per_iteration())
    }

    /// Environments of one shard.
    pub fn envs_per_shard(&self) -> usize {
        self.env.n_envs / self.env.n_shards
    }

    /// Reads a resolved configuration, as `config.toml` of a run directory holds it.
    pub fn from_resolved_toml(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let config = typed::typed(layers::parse(text, origin)?, |_| origin.to_owned())?;
        config.validate()?;
        Ok(config)
    }

    /// The resolved configuration as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a typed configuration has a TOML form")
    }
}

#[cfg(test)]
mod tests;
