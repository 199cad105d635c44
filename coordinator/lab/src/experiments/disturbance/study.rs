//! What is asked of the experiment.

use super::super::common::Common;

/// What is asked of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Policies, robot, episodes.
    pub common: Common,
    /// The arm that is disturbed in the trajectory task, counted from 1.
    pub arm: usize,
    /// The control step that it begins with.
    pub at: usize,
    /// Force on the hand (N).
    pub force: f64,
    /// Torque on the base (N m).
    pub torque: f64,
}

impl Default for Study {
    /// As in the paper, and as far as it tells.
    fn default() -> Self {
        Self { common: Common::default(), arm: 2, at: 75, force: 50.0, torque: 5.0 }
    }
}
