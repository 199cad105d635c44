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

mod layers;
mod sections;

pub use layers::{Layers, Preset};
pub use sections::{
    Activation, Algorithm, AlgorithmName, Config, CriticState, Env, Exploration, GoalBox,
    Inference, InputNorm, Integrator, JointAngles, Maddpg, Network, Observation, Optimizer,
    ParameterSharing, Precision, Reward, RewardWeights, RobotSection, Run, Schedule, Start, Task,
    TaskName,
};

#[cfg(test)]
mod tests;
