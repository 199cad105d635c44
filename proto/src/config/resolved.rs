//! A resolved configuration, and what follows from it alone.

use serde::{Deserialize, Serialize};

use super::algorithm::{Algorithm, AlgorithmName};
use super::env::{Env, RobotSection};
use super::maddpg::Exploration;
use super::network::{CriticState, Network};
use super::optimizer::Optimizer;
use super::run::Run;
use super::task::Task;

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

    /// Critics of `n_actors` actors: one each, or with `network.shared_critics` one with an output for each of those who are one actor.
    /// Critic c of C is that of the actors c, c + C, c + 2C and so on.
    pub fn critics(&self, n_actors: usize) -> usize {
        let Network { shared_critics, critic_state, .. } = self.network;
        let name = self.algorithm.name;
        let see_all = name == AlgorithmName::Mappo && critic_state != CriticState::Own;
        if shared_critics && see_all { self.network.actor_networks(n_actors) } else { n_actors }
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

    /// The resolved configuration as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a typed configuration has a TOML form")
    }
}
