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
mod preset;
mod resolved;
mod run;
mod tables;
mod task;
mod typed;
mod validation;

pub use algorithm::{Algorithm, AlgorithmName};
pub use env::{Env, Integrator, RobotSection};
pub use layers::Layers;
pub use maddpg::{Exploration, Maddpg};
pub use network::{Activation, CriticState, Inference, InputNorm, Network, ParameterSharing};
pub use optimizer::{Optimizer, Schedule};
pub use preset::Preset;
pub use resolved::Config;
pub use run::{Precision, Run};
pub use tables::{hint, in_line, parse};
pub use task::{
    JointAngles, Observation, Posture, Randomization, Reward, RewardWeights, Start, Task,
};

pub use crate::tasks::{GoalBox, Target, TaskName};

#[cfg(test)]
mod tests;
