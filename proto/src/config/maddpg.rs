//! Group `algorithm.maddpg`: what only MADDPG uses, and how it explores.
//!
//! **Workers know the schedule of the noise.** It is a function of the iteration, so a rollout stays a pure
//! function, and the policy that is published holds no exploration.

use serde::{Deserialize, Serialize};

/// Group `algorithm.maddpg`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Maddpg {
    /// L: actions are L times the hyperbolic tangent of an actor's output, before the environment clips
    /// and scales them; critics see them in units of L.
    pub action_limit: f64,
    /// τ: how far targets move towards their networks after an update.
    pub soft_update: f64,
    /// Env-steps that the replay holds, rounded down to whole episodes. It is part of every checkpoint,
    /// with four bytes for each number that agents see, do and get in a step.
    pub replay_steps: usize,
    /// Samples of an update.
    pub batch_size: usize,
    /// Updates of all networks for an env-step.
    pub updates_per_step: f64,
    /// Env-steps before the first update.
    pub learning_starts: u64,
    /// Standard deviation of the normal exploration noise at first, in units of L.
    pub noise: f64,
    /// Likewise from `noise_steps` on; it falls linearly until then.
    pub noise_final: f64,
    /// Probability at first that an agent's action is uniform in ± L instead.
    pub random: f64,
    /// Likewise from `noise_steps` on; it falls linearly until then.
    pub random_final: f64,
    /// Env-steps over which both fall.
    pub noise_steps: u64,
}

/// The numbers of the released code.
impl Default for Maddpg {
    fn default() -> Self {
        Self {
            action_limit: 10.0,
            soft_update: 0.01,
            replay_steps: 500_000,
            batch_size: 256,
            updates_per_step: 1.0,
            learning_starts: 256,
            noise: 0.1,
            noise_final: 0.05,
            random: 0.05,
            random_final: 0.05,
            noise_steps: 100_000,
        }
    }
}

/// How actions of a deterministic actor depart from its output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exploration {
    /// Actions stay in ± this.
    pub limit: f64,
    /// Standard deviation of the normal noise, in the actions' own units.
    pub std: f64,
    /// Probability of a uniform action.
    pub random: f64,
}

impl Maddpg {
    /// Exploration after `env_steps`.
    pub fn exploration(&self, env_steps: u64) -> Exploration {
        let progress = (env_steps as f64 / self.noise_steps.max(1) as f64).min(1.0);
        let between = |first: f64, last: f64| first + (last - first) * progress;
        Exploration {
            limit: self.action_limit,
            std: self.action_limit * between(self.noise, self.noise_final),
            random: between(self.random, self.random_final),
        }
    }

    /// Updates that are to be made by the time that `env_steps` have been collected.
    pub fn updates_until(&self, env_steps: u64) -> u64 {
        let counted = env_steps.saturating_sub(self.learning_starts);
        (counted as f64 * self.updates_per_step).floor() as u64
    }
}
