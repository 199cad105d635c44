//! `mixed`: the first half of the arms reach while the others turn the base under them.
//!
//! What the paper puts together from two trainings (its reassembly of policies) is trained here as one. An arm that turns the
//! base is paid for the base alone, one that reaches for its hand alone.

use super::{Aim, EpisodeGoals, GoalAddress, GoalRanges, TaskDefinition};

/// See the file.
pub(super) struct Mixed;

impl TaskDefinition for Mixed {
    fn about(&self) -> &'static str {
        "Hands of half of the arms to target poses, the base by the others to a target attitude"
    }

    fn fewest_arms(&self) -> usize {
        2
    }

    fn aim(&self, arm: usize, n_arms: usize) -> Aim {
        if 2 * arm < n_arms { Aim::Hand } else { Aim::Base }
    }

    fn goals(&self, ranges: &GoalRanges, address: GoalAddress) -> EpisodeGoals {
        let n_arms = ranges.arms.len();
        let hand = |arm| (self.aim(arm, n_arms) == Aim::Hand).then(|| ranges.hand(arm, address));
        // Another stream than the hands': theirs begins with the first arm's numbers.
        let attitude = ranges.attitude_of(address, 2 * n_arms as u32);
        EpisodeGoals {
            hands: (0..n_arms).map(hand).collect(),
            base: Some(attitude),
            ..EpisodeGoals::default()
        }
    }
}
