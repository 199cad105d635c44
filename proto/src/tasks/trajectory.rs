//! `trajectory`: every hand to a pose [Zhao et al., section III].

use super::{Aim, EpisodeGoals, GoalAddress, GoalRanges, TaskDefinition};

/// See the file.
pub(super) struct Trajectory;

impl TaskDefinition for Trajectory {
    fn about(&self) -> &'static str {
        "Every hand to a target pose"
    }

    fn aim(&self, _: usize, _: usize) -> Aim {
        Aim::Hand
    }

    fn goals(&self, ranges: &GoalRanges, address: GoalAddress) -> EpisodeGoals {
        let hands = (0..ranges.arms.len()).map(|arm| Some(ranges.hand(arm, address)));
        EpisodeGoals { hands: hands.collect(), ..EpisodeGoals::default() }
    }
}
