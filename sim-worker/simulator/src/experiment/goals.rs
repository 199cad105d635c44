//! Goals that are given instead of drawn, and those of an evaluation's episodes.

use proto::rng::Purpose;

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

    /// Target pose of a hand: position (m) and Euler angles (rad), world.
    pub fn hand(&self, world: &World, episode: u32, arm: usize) -> [f64; 6] {
        let given = self.given.get(episode as usize);
        let given = given.and_then(|goals| goals.hands.get(arm).copied().flatten());
        given.unwrap_or_else(|| world.task.goals.hand(arm, self.address(episode)))
    }

    /// Target attitude of the base, Euler angles (rad).
    pub fn base(&self, world: &World, episode: u32) -> [f64; 3] {
        let given = self.given.get(episode as usize).and_then(|goals| goals.base);
        given.unwrap_or_else(|| world.task.goals.attitude(self.address(episode)))
    }
}
