//! How often all goals of an episode were held, in tasks in which they have to be.

use proto::statistics::quantile;
use serde::{Deserialize, Serialize};
use simulator::evaluate::EpisodeResult;

use crate::statistics::{number, percent};

/// Over an evaluation's episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HeldShare {
    /// Share of episodes in which all goals were held for as long as the task wants.
    #[serde(deserialize_with = "number")]
    pub episodes: f64,
    /// Share of episodes in which they were, and no two bodies had touched before.
    #[serde(deserialize_with = "number")]
    pub untouched: f64,
    /// Median of the control steps after which they had been held, where they were.
    #[serde(deserialize_with = "number")]
    pub median_step: f64,
}

impl HeldShare {
    /// None where the task does not want goals held.
    pub(super) fn of(episodes: &[EpisodeResult]) -> Option<Self> {
        let held: Vec<_> = episodes.iter().filter_map(|episode| episode.held).collect();
        if held.is_empty() {
            return None;
        }
        let share = |n: usize| n as f64 / held.len() as f64;
        let mut steps: Vec<f64> =
            held.iter().filter_map(|held| Some(f64::from(held.done?) + 1.0)).collect();
        steps.sort_by(f64::total_cmp);
        let untouched = held.iter().filter(|held| held.done.is_some() && !held.touched_before);
        Some(Self {
            episodes: share(steps.len()),
            untouched: share(untouched.count()),
            median_step: quantile(&steps, 0.5),
        })
    }

    /// A line of the table.
    pub(super) fn line(&self) -> String {
        let Self { episodes, untouched, median_step } = self;
        let when = if median_step.is_nan() {
            String::new()
        } else {
            format!("; half of them by step {median_step:.0}")
        };
        format!(
            "all goals held in {} of episodes, in {} without a touch before{when}\n",
            percent(*episodes),
            percent(*untouched)
        )
    }
}

#[cfg(test)]
mod tests {
    use simulator::evaluate::Held;

    use super::super::tests::blank;
    use super::*;

    #[test]
    fn shares_are_of_all_episodes_and_times_of_those_that_held() {
        let episode = |done, touched_before| EpisodeResult {
            held: Some(Held { longest: 3, done, touched_before }),
            ..blank()
        };
        let all = [
            episode(Some(9), false),
            episode(Some(19), false),
            episode(Some(39), true),
            episode(None, false),
        ];
        let found = HeldShare::of(&all).expect("held");
        assert_eq!(found, HeldShare { episodes: 0.75, untouched: 0.5, median_step: 20.0 });
        assert!(found.line().contains("75.0 % of episodes, in 50.0 %"), "{}", found.line());
        let never = HeldShare::of(&all[3..]).expect("not held");
        assert!((never.episodes, never.median_step.is_nan()) == (0.0, true), "{never:?}");
        assert!(!never.line().contains("half"));
        let others = EpisodeResult { held: None, ..episode(None, false) };
        assert_eq!(HeldShare::of(&[others]), None);
    }
}
