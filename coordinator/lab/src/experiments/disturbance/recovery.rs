//! How an error went that was disturbed, and when it was small again.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use simulator::evaluate::Course;
use simulator::experiment::Recording;

use super::super::report::{CourseOfMany, share, spread};
use crate::statistics::{ErrorOf, Spread, Unit};

/// How an error went: the largest of its three axes.
#[derive(Debug, Serialize, Deserialize)]
pub struct Recovery {
    pub(crate) error: ErrorOf,
    pub(crate) unit: Unit,
    /// What counts as recovered.
    pub(crate) threshold: f32,
    /// After the last step before the disturbance.
    pub(super) before: Spread,
    /// After its last step.
    pub(super) at: Spread,
    /// Largest from its first step on.
    pub(crate) peak: Spread,
    /// Mean of the last 20 steps.
    pub(crate) tail: Spread,
    /// Share of episodes below the threshold before the disturbance.
    pub(super) below_before: f64,
    /// Share of episodes that come below the threshold after it.
    pub(crate) recovered: f64,
    /// Steps after the disturbance until they do, of those that do.
    pub(super) steps_to_recover: Option<Spread>,
    /// Share of episodes below the threshold in the mean of the last 20 steps.
    pub(crate) below_tail: f64,
    /// Mean of the last 20 steps of each episode.
    #[serde(skip)]
    tails: Vec<f32>,
    /// The same share of the episodes whose goal is within reach where they end.
    #[serde(default)]
    pub(super) below_tail_within_reach: Option<f64>,
    pub(crate) course: CourseOfMany,
}

impl Recovery {
    /// What `value` says about an episode and a step, disturbed in `steps`.
    pub(super) fn of(
        recording: &Recording,
        error: ErrorOf,
        threshold: f32,
        steps: &Range<usize>,
        value: impl Fn(usize, usize) -> f32 + Copy,
    ) -> Self {
        let (n, end) = (recording.episodes(), recording.steps());
        let tail = |episode| Course::of((0..end).map(move |step| value(episode, step))).tail;
        let tails: Vec<f32> = (0..n).map(tail).collect();
        let soonest: Vec<f32> = (0..n)
            .filter_map(|episode| {
                let mut after = (steps.end..end).enumerate();
                let (index, _) = after.find(|(_, step)| value(episode, *step) < threshold)?;
                Some((index + 1) as f32)
            })
            .collect();
        let before = steps.start - 1;
        Self {
            error,
            unit: error.unit(),
            threshold,
            before: spread((0..n).map(|episode| value(episode, before))),
            at: spread((0..n).map(|episode| value(episode, steps.end - 1))),
            peak: spread((0..n).map(|episode| {
                (steps.start..end).map(|step| value(episode, step)).fold(0.0, f32::max)
            })),
            tail: spread(tails.iter().copied()),
            below_before: share(n, |episode| value(episode, before) < threshold),
            recovered: soonest.len() as f64 / n.max(1) as f64,
            steps_to_recover: (!soonest.is_empty()).then(|| spread(soonest.into_iter())),
            below_tail: share(n, |episode| tails[episode] < threshold),
            below_tail_within_reach: None,
            tails,
            course: CourseOfMany::of(recording, value),
        }
    }

    /// Looks at those episodes again of which `within_reach` says that the goal is.
    pub(super) fn look_within_reach(&mut self, within_reach: &[bool]) {
        let below = |episode: usize| self.tails[episode] < self.threshold;
        self.below_tail_within_reach = share_of(within_reach, below);
    }
}

/// The share of the episodes that `of` names which satisfy a condition; none if it names none.
fn share_of(of: &[bool], holds: impl Fn(usize) -> bool) -> Option<f64> {
    let named: Vec<usize> = (0..of.len()).filter(|&episode| of[episode]).collect();
    (!named.is_empty()).then(|| share(named.len(), |index| holds(named[index])))
}

#[cfg(test)]
mod tests {
    use super::super::super::report::tests::resting;
    use super::*;

    #[test]
    fn a_recovery_by_hand() {
        let recording = resting(2, 30);
        // Episode 0: 10 before, 100 at step 4, then halved with every step; episode 1: 50 from step 4 on.
        let value = |episode: usize, step: usize| match (episode, step) {
            (_, 0..4) => 10.0,
            (0, _) => 100.0 * 0.5_f32.powi(step as i32 - 4),
            _ => 50.0,
        };
        let recovery = Recovery::of(&recording, ErrorOf::Base, 20.0, &(4..5), value);
        assert_eq!(
            (recovery.before.mean, recovery.at.mean, recovery.peak.mean),
            (10.0, 75.0, 75.0)
        );
        assert_eq!(
            (recovery.below_before, recovery.recovered, recovery.below_tail),
            (1.0, 0.5, 0.5)
        );
        // 50, 25, 12.5: the third step after.
        let steps = recovery.steps_to_recover.expect("one recovers");
        assert_eq!((steps.mean, steps.std), (3.0, 0.0));
        assert_eq!(share_of(&[true, false], |e| recovery.tails[e] < 20.0), Some(1.0));
        assert_eq!(share_of(&[false, true], |e| recovery.tails[e] < 20.0), Some(0.0));
        assert_eq!(share_of(&[false, false], |_| true), None);
        let never = Recovery::of(&recording, ErrorOf::Base, 1e-9, &(4..5), value);
        assert_eq!((never.recovered, never.steps_to_recover), (0.0, None));
    }
}
