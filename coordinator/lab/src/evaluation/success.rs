//! How many goals of an evaluation count as reached.

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::evaluate::{EpisodeResult, HandCourse};

use crate::statistics::{number, papers};

/// Share of goals reached, judged after the last step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Success {
    /// Largest position error that counts (m); none in `reorientation`.
    pub position: Option<f64>,
    /// Largest orientation or attitude error that counts (rad).
    pub orientation: f64,
    /// Share of goals: of hands in `trajectory`, of the base in `reorientation`.
    #[serde(deserialize_with = "number")]
    pub goals: f64,
    /// Share of episodes that reached all their goals, of those that have any.
    #[serde(deserialize_with = "number")]
    pub episodes: f64,
}

/// Largest errors that count in the released code: of positions (m) and attitudes (rad).
const RELEASED: (f64, f64) = (0.05, 0.05);

/// By the released code's thresholds, and by the paper's. Where there are no goals the shares are NaN.
pub(super) fn success(task: TaskName, episodes: &[EpisodeResult]) -> Vec<Success> {
    let judge = |(position, orientation): (f64, f64)| {
        let reached: Vec<Vec<bool>> = episodes
            .iter()
            .map(|episode| match task {
                TaskName::Trajectory => {
                    let hand = |hand: &HandCourse| {
                        f64::from(hand.position.last) < position
                            && f64::from(hand.orientation.last) < orientation
                    };
                    episode.hands.iter().map(hand).collect()
                }
                TaskName::Reorientation => vec![f64::from(episode.base.last) < orientation],
            })
            // An episode without goals has neither reached nor missed them all.
            .filter(|reached: &Vec<bool>| !reached.is_empty())
            .collect();
        let goals = reached.iter().map(Vec::len).sum::<usize>() as f64;
        let hits = reached.iter().flatten().filter(|hit| **hit).count() as f64;
        let whole = reached.iter().filter(|goals| goals.iter().all(|hit| *hit)).count() as f64;
        Success {
            position: (task == TaskName::Trajectory).then_some(position),
            orientation,
            goals: hits / goals,
            episodes: whole / reached.len() as f64,
        }
    };
    [RELEASED, papers(task)].map(judge).to_vec()
}
