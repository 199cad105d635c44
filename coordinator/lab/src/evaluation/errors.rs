//! Errors of an evaluation's episodes: of all agents together, and of each alone.

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::evaluate::{Course, EpisodeResult};

use crate::statistics::{ErrorOf, Spread, Unit};

/// One kind of error, of one agent or of all together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// What it is of.
    pub error: ErrorOf,
    /// What it is measured in.
    pub unit: Unit,
    /// The agent that answers for it, if it is one alone.
    pub agent: Option<usize>,
    /// Smallest of each episode: flatters, but is what the released script reports.
    pub min: Spread,
    /// After the last step.
    #[serde(rename = "final")]
    pub last: Spread,
    /// Mean over the last 20 steps of each episode.
    pub tail: Spread,
}

fn summarise(error: ErrorOf, agent: Option<usize>, courses: &[Course]) -> ErrorSummary {
    let spread = |read: fn(&Course) -> f32| {
        Spread::of(courses.iter().map(|course| f64::from(read(course))).collect())
    };
    ErrorSummary {
        error,
        unit: error.unit(),
        agent,
        min: spread(|course| course.min),
        last: spread(|course| course.last),
        tail: spread(|course| course.tail),
    }
}

/// Of all agents together, one a kind of error that the task is about.
pub(super) fn overall(task: TaskName, episodes: &[EpisodeResult]) -> Vec<ErrorSummary> {
    let hands = || episodes.iter().flat_map(|episode| &episode.hands);
    match task {
        TaskName::Trajectory => vec![
            summarise(
                ErrorOf::Position,
                None,
                &hands().map(|hand| hand.position).collect::<Vec<_>>(),
            ),
            summarise(
                ErrorOf::Orientation,
                None,
                &hands().map(|hand| hand.orientation).collect::<Vec<_>>(),
            ),
        ],
        TaskName::Reorientation => {
            let courses: Vec<_> = episodes.iter().map(|episode| episode.base).collect();
            vec![summarise(ErrorOf::Base, None, &courses)]
        }
    }
}

/// Agent 2i moves the shoulder of arm i and answers for the hand's position, agent 2i + 1 moves
/// the wrist and answers for its orientation.
pub(super) fn agents(task: TaskName, episodes: &[EpisodeResult]) -> Vec<ErrorSummary> {
    if task == TaskName::Reorientation {
        return Vec::new();
    }
    let n_arms = episodes.first().map_or(0, |episode| episode.hands.len());
    (0..n_arms)
        .flat_map(|arm| {
            let hands = || episodes.iter().filter_map(move |episode| episode.hands.get(arm));
            let position: Vec<_> = hands().map(|hand| hand.position).collect();
            let orientation: Vec<_> = hands().map(|hand| hand.orientation).collect();
            [
                summarise(ErrorOf::Position, Some(2 * arm), &position),
                summarise(ErrorOf::Orientation, Some(2 * arm + 1), &orientation),
            ]
        })
        .collect()
}
