//! What makes an episode of training another one than that of an evaluation.

use proto::config::{Randomization, Start, Task};

/// Where episodes begin, and what errs in them. The default is an evaluation's: at home, and nothing.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Conditions {
    pub(crate) start: Start,
    pub(crate) randomization: Randomization,
    /// Whether hands without a way to their goals rest, so that they do not disturb those who learn.
    pub(crate) rest: bool,
}

impl Conditions {
    /// Those of a task's training.
    pub(crate) fn of_training(task: &Task) -> Self {
        Self { start: task.start, randomization: task.randomization, rest: true }
    }
}
