//! What all rollouts of a run share.

use proto::config::Config;
use proto::layout::{BlockLayout, Dimensions};

use crate::policy::{Policy, PolicyError};
use crate::robot::Robot;
use crate::task::Task;

/// Everything of a run that rollouts share and that never changes.
#[derive(Debug, Clone)]
pub struct World {
    /// The configuration.
    pub config: Config,
    /// The sizes that follow.
    pub dimensions: Dimensions,
    /// The robot.
    pub robot: Robot,
    /// The task on this robot.
    pub task: Task,
    pub(super) layout: BlockLayout,
}

impl World {
    /// The world of a configuration and a robot.
    pub fn new(config: &Config, robot: &Robot) -> Self {
        let dimensions = Dimensions::new(config, robot.joints);
        Self {
            config: config.clone(),
            dimensions,
            robot: robot.clone(),
            task: Task::new(config, crate::env::home(robot)),
            layout: BlockLayout::new(&dimensions),
        }
    }

    /// Env-steps of a block.
    pub fn block_env_steps(&self) -> u64 {
        (self.dimensions.n_envs * self.dimensions.n_steps) as u64
    }

    /// Where the arrays of a block stand.
    pub fn block_layout(&self) -> &BlockLayout {
        &self.layout
    }

    /// Undiscounted return of an episode, mean over a block's environments, an agent each.
    pub fn mean_returns(&self, block: &[f32]) -> Vec<f64> {
        let Dimensions { n_steps, n_envs, .. } = self.dimensions;
        let of_agents = block[self.layout.reward.clone()].chunks_exact(n_steps * n_envs);
        let sum = |rewards: &[f32]| rewards.iter().map(|&reward| f64::from(reward)).sum::<f64>();
        of_agents.map(|rewards| sum(rewards) / n_envs as f64).collect()
    }

    /// Checks and packs the parameters of a policy version.
    pub fn policy(&self, parameters: &[f32]) -> Result<Policy, PolicyError> {
        Policy::new(&self.config, &self.dimensions, parameters)
    }
}
