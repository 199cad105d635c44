//! Goals that are given instead of drawn, and those of an evaluation's episodes.

use proto::rng::Purpose;
use proto::tasks::EpisodeGoals;

use crate::rollout::World;
use crate::task::goal::GoalAddress;

/// Goals that are given instead of drawn.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FixedGoals {
    /// Target of each hand, position in the world (m) and Euler angles (rad); arms beyond the end have none.
    pub hands: Vec<Option<[f64; 6]>>,
    /// Target attitude of the base, Euler angles (rad).
    pub base: Option<[f64; 3]>,
}

/// Goals of an evaluation's episodes: held-out ones, or given ones.
#[derive(Debug, Clone, Copy)]
pub struct EvaluationGoals<'a> {
    /// Seed of the goals that are drawn.
    pub seed: u64,
    /// Goals that are given instead, an entry an episode; what is beyond the end is drawn.
    pub given: &'a [FixedGoals],
}

impl EvaluationGoals<'_> {
    /// The held-out goals of a seed.
    pub fn drawn(seed: u64) -> Self {
        Self { seed, given: &[] }
    }

    /// Address of an episode's goals.
    pub fn address(&self, episode: u32) -> GoalAddress {
        let purpose = Purpose::EvaluationGoal;
        GoalAddress { seed: self.seed, purpose, iteration: 0, env: episode }
    }

    /// Target pose of a hand where the episode begins: position (m) and Euler angles (rad), world. Home where it has none.
    pub fn hand(&self, world: &World, episode: u32, arm: usize) -> [f64; 6] {
        let given = self.given.get(episode as usize);
        let given = given.and_then(|goals| goals.hands.get(arm).copied().flatten());
        given
            .or_else(|| self.drawn_for(world, episode).hands.get(arm).copied().flatten())
            .unwrap_or_else(|| {
                let home = &world.task.goals.home.arms[arm];
                let [[x, y, z], [a, b, c]] = [home.position, home.euler];
                [x, y, z, a, b, c]
            })
    }

    /// Target attitude of the base, Euler angles (rad). Home where it has none.
    pub fn base(&self, world: &World, episode: u32) -> [f64; 3] {
        let given = self.given.get(episode as usize).and_then(|goals| goals.base);
        given
            .or_else(|| self.drawn_for(world, episode).base)
            .unwrap_or(world.task.goals.home.base_euler)
    }

    /// The goals that are drawn for an episode.
    fn drawn_for(&self, world: &World, episode: u32) -> EpisodeGoals {
        world.task.name.definition().goals(&world.task.goals, self.address(episode))
    }
}
