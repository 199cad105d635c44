//! Errors of an evaluation's episodes: of all agents together, and of each alone.

use proto::config::TaskName;
use proto::tasks::Aim;
use serde::{Deserialize, Serialize};
use simulator::evaluate::{Course, EpisodeResult, HandCourse};

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

/// The hands of an episode that have goals; all where the episode is a part of one.
fn hands(task: TaskName, episode: &EpisodeResult) -> impl Iterator<Item = (usize, &HandCourse)> {
    let n_arms = episode.hands.len();
    let aims = move |(arm, _): &(usize, &HandCourse)| {
        task.only_reaches() || task.aim(*arm, n_arms) == Aim::Hand
    };
    episode.hands.iter().enumerate().filter(aims)
}

/// The courses of one error of a task.
fn courses(task: TaskName, error: ErrorOf, episodes: &[EpisodeResult]) -> Vec<(usize, Course)> {
    let of_hands = |of: fn(&HandCourse) -> Course| {
        let all = episodes.iter().flat_map(|episode| hands(task, episode));
        all.map(|(arm, hand)| (arm, of(hand))).collect()
    };
    match error {
        ErrorOf::Position => of_hands(|hand| hand.position),
        ErrorOf::Orientation => of_hands(|hand| hand.orientation),
        ErrorOf::Base => episodes.iter().map(|episode| (0, episode.base)).collect(),
    }
}

/// Of all agents together, one a kind of error that the task is about.
pub(super) fn overall(task: TaskName, episodes: &[EpisodeResult]) -> Vec<ErrorSummary> {
    let of = |error| {
        let courses: Vec<_> = courses(task, error, episodes).into_iter().map(|(_, c)| c).collect();
        summarise(error, None, &courses)
    };
    ErrorOf::of(task).map(of).collect()
}

/// Agent 2i moves the shoulder of arm i and answers for the hand's position, agent 2i + 1 moves
/// the wrist and answers for its orientation. None of arms that turn the base, which all answer for it.
pub(super) fn agents(task: TaskName, episodes: &[EpisodeResult]) -> Vec<ErrorSummary> {
    if !task.reaches() {
        return Vec::new();
    }
    let kinds = [ErrorOf::Position, ErrorOf::Orientation];
    let all = kinds.map(|error| courses(task, error, episodes));
    let n_arms = episodes.first().map_or(0, |episode| episode.hands.len());
    let of_agent = |agent: usize| {
        let (arm, kind) = (agent / kinds.len(), agent % kinds.len());
        let own = all[kind].iter().filter(|(of, _)| *of == arm).map(|(_, course)| *course);
        let own: Vec<Course> = own.collect();
        (!own.is_empty()).then(|| summarise(kinds[kind], Some(agent), &own))
    };
    (0..kinds.len() * n_arms).filter_map(of_agent).collect()
}

/// Which of its goals an episode reached, by errors after the last step below `position` (m), `angle` of hands and of the `base` (rad).
pub(super) fn reached(
    task: TaskName,
    episode: &EpisodeResult,
    (position, angle, base): (f64, f64, f64),
) -> Vec<bool> {
    let of_hand = |(_, hand): (usize, &HandCourse)| {
        f64::from(hand.position.last) < position && f64::from(hand.orientation.last) < angle
    };
    let hands = hands(task, episode).filter(|_| task.reaches()).map(of_hand);
    let base = task.turns().then(|| f64::from(episode.base.last) < base);
    hands.chain(base).collect()
}
