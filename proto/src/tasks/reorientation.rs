//! `reorientation`: all arms together turn the base to an attitude [Zhao et al., section III].

use super::{Aim, EpisodeGoals, GoalAddress, GoalRanges, TaskDefinition};

/// See the file.
pub(super) struct Reorientation;

impl TaskDefinition for Reorientation {
    fn about(&self) -> &'static str {
        "The base to a target attitude"
    }

    fn aim(&self, _: usize, _: usize) -> Aim {
        Aim::Base
    }

    fn goals(&self, ranges: &GoalRanges, address: GoalAddress) -> EpisodeGoals {
        EpisodeGoals { base: Some(ranges.attitude(address)), ..EpisodeGoals::default() }
    }
}
