//! How often the learner has died without getting further, and when that is too often.

use crate::supervisor::{Cause, Deaths};

/// Deaths of the learner without a new iteration in between that end the run.
const MAX_CRASHES: u32 = 3;
/// The same for deaths by a signal from outside.
const MAX_KILLS: u32 = 50;

/// Deaths since the training last got further than it had ever been.
///
/// After a death iterations are trained again, with the same bits. That they succeed again says nothing: what ends the learner by itself lies where it died.
#[derive(Debug, Default)]
pub(super) struct LearnerDeaths {
    deaths: Deaths,
    /// Most iterations that were trained.
    furthest: u64,
}

impl LearnerDeaths {
    /// One more.
    pub(super) fn count(&mut self, cause: Cause) {
        self.deaths.count(cause);
    }

    /// So many iterations are trained.
    pub(super) fn trained(&mut self, iterations: u64) {
        if iterations > self.furthest {
            *self = Self { deaths: Deaths::default(), furthest: iterations };
        }
    }

    /// Whether there are as many as end a run.
    pub(super) fn are_too_many(&self) -> bool {
        self.deaths.are_too_many(MAX_CRASHES, MAX_KILLS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_learner_that_dies_at_the_same_iteration_again_and_again_ends_the_run() {
        let mut deaths = LearnerDeaths::default();
        (1..=137).for_each(|iterations| deaths.trained(iterations));
        for _ in 0..2 {
            deaths.count(Cause::Hang);
            assert!(!deaths.are_too_many());
            // From the last checkpoint to where it died.
            (101..=137).for_each(|iterations| deaths.trained(iterations));
        }
        deaths.count(Cause::Hang);
        assert!(deaths.are_too_many());
    }

    #[test]
    fn deaths_that_a_new_iteration_follows_are_forgotten() {
        let mut deaths = LearnerDeaths::default();
        for iteration in 1..=10 {
            deaths.count(Cause::Hang);
            deaths.trained(iteration);
            assert!(!deaths.are_too_many());
        }
    }
}
