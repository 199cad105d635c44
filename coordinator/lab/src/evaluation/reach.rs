//! Which hand goals could be reached at all, and how an evaluation does on these alone.

use proto::config::TaskName;
use run::report::progress::Parts;
use serde::{Deserialize, Serialize};
use simulator::evaluate::{EpisodeResult, Evaluation};
use simulator::experiment::EvaluationGoals;
use simulator::reach::{self, HandReach};
use simulator::rollout::World;

use super::errors::{ErrorSummary, overall};
use super::success::{Success, success};
use crate::threads::Threads;

/// What remains without the goals that cannot be reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reachable {
    /// Of the hand goals that a controller which knows the robot reaches; there may be more.
    #[serde(flatten)]
    pub subset: GoalSubset,
    /// How the controller did, `[episode][arm]`.
    pub controller: Vec<Vec<HandReach>>,
}

/// What remains without the goals that no joint angles reached with the base where the episode ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WithinReach {
    /// Of the hand goals for which inverse kinematics has a solution there; fewer can be held, as arms touch.
    #[serde(flatten)]
    pub subset: GoalSubset,
    /// Which they are, `[episode][arm]`.
    pub hands: Vec<Vec<bool>>,
}

/// What an evaluation found of some of the hand goals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GoalSubset {
    /// So many goals.
    pub goals: usize,
    /// Of so many.
    pub of: usize,
    /// Errors of the hands with these goals.
    pub overall: Vec<ErrorSummary>,
    /// Shares of these goals.
    pub success: Vec<Success>,
}

impl GoalSubset {
    /// Of the hands that `chosen` names, `[episode][arm]`.
    pub(super) fn of(episodes: &[EpisodeResult], chosen: &[Vec<bool>]) -> Self {
        let of_episode = |(episode, chosen): (&EpisodeResult, &Vec<bool>)| {
            let hands = episode.hands.iter().zip(chosen).filter(|(_, chosen)| **chosen);
            EpisodeResult { hands: hands.map(|(hand, _)| *hand).collect(), ..episode.clone() }
        };
        let of = chosen.iter().map(Vec::len).sum();
        let episodes: Vec<_> = episodes.iter().zip(chosen).map(of_episode).collect();
        Self {
            goals: episodes.iter().map(|episode| episode.hands.len()).sum(),
            of,
            overall: overall(TaskName::Trajectory, &episodes),
            success: success(TaskName::Trajectory, &episodes),
        }
    }
}

/// How a controller that knows the robot does with the hand goals of so many episodes, `[episode][arm]`.
///
/// # Errors
/// If the simulation diverges.
pub fn reachable(
    world: &World,
    goals: EvaluationGoals<'_>,
    episodes: usize,
    threads: Threads,
    progress: &Parts,
) -> anyhow::Result<Vec<Vec<HandReach>>> {
    progress.begin("which goals can be reached", episodes as u64);
    let on_episodes = |n| (0..n).for_each(|_| progress.advance());
    Ok(reach::reach(world, goals, episodes, &threads, &on_episodes)?)
}

/// Which hand goals of an evaluation could be reached, `[episode][arm]`.
#[derive(Debug, Clone)]
pub struct Reach {
    /// How a controller that knows the robot does.
    controller: Vec<Vec<HandReach>>,
    /// Whether a goal was within reach with the base where the episode ended.
    at_end: Vec<Vec<bool>>,
}

impl Reach {
    /// Of the goals in whose episodes `evaluation` ended; none where the base has goals or goals move.
    pub fn of(
        world: &World,
        evaluation: &Evaluation,
        goals: EvaluationGoals<'_>,
        threads: Threads,
        progress: &Parts,
    ) -> anyhow::Result<Option<Self>> {
        if !world.task.name.only_reaches() || world.task.name.moves() {
            return Ok(None);
        }
        let episodes = evaluation.episodes.len();
        let controller = reachable(world, goals, episodes, threads, progress)?;
        let ends: Vec<_> = evaluation.episodes.iter().map(|episode| &episode.end).collect();
        let at_end = reach::within_reach(world, goals, &ends, &threads);
        Ok(Some(Self { controller, at_end }))
    }

    /// What the episodes found of the goals that a controller reaches, and of those that were within reach at the end.
    pub(super) fn subsets(self, episodes: &[EpisodeResult]) -> (Reachable, WithinReach) {
        let Self { controller, at_end } = self;
        let reached: Vec<Vec<bool>> = controller
            .iter()
            .map(|hands| hands.iter().map(|hand| hand.reached).collect())
            .collect();
        let reachable = Reachable { subset: GoalSubset::of(episodes, &reached), controller };
        let within_reach = WithinReach { subset: GoalSubset::of(episodes, &at_end), hands: at_end };
        (reachable, within_reach)
    }
}
