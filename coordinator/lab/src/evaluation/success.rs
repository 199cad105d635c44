//! How many goals of an evaluation count as reached.

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::evaluate::EpisodeResult;

use super::errors::reached;
use crate::statistics::{ErrorOf, number};

/// Share of goals reached, judged after the last step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Success {
    /// Largest position error that counts (m); none where hands have no goals.
    pub position: Option<f64>,
    /// Largest orientation or attitude error that counts (rad).
    pub orientation: f64,
    /// Share of goals, of hands and of the base.
    #[serde(deserialize_with = "number")]
    pub goals: f64,
    /// Share of episodes that reached all their goals, of those that have any.
    #[serde(deserialize_with = "number")]
    pub episodes: f64,
}

/// Largest errors that count in the released code: of positions (m), of orientations and of the base (rad).
const RELEASED: (f64, f64, f64) = (0.05, 0.05, 0.05);

/// By the released code's thresholds, and by the paper's. Where there are no goals the shares are NaN.
pub(super) fn success(task: TaskName, episodes: &[EpisodeResult]) -> Vec<Success> {
    let judge = |(position, orientation, base): (f64, f64, f64)| {
        let reached: Vec<Vec<bool>> = episodes
            .iter()
            .map(|episode| reached(task, episode, (position, orientation, base)))
            // An episode without goals has neither reached nor missed them all.
            .filter(|reached: &Vec<bool>| !reached.is_empty())
            .collect();
        let goals = reached.iter().map(Vec::len).sum::<usize>() as f64;
        let hits = reached.iter().flatten().filter(|hit| **hit).count() as f64;
        let whole = reached.iter().filter(|goals| goals.iter().all(|hit| *hit)).count() as f64;
        Success {
            position: task.reaches().then_some(position),
            orientation: if task.reaches() { orientation } else { base },
            goals: hits / goals,
            episodes: whole / reached.len() as f64,
        }
    };
    let papers = [ErrorOf::Position, ErrorOf::Orientation, ErrorOf::Base].map(ErrorOf::papers);
    [RELEASED, papers.into()].map(judge).to_vec()
}
