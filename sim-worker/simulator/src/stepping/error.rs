//! Why a step is not made.

use crate::env::EpisodeError;

/// Why a batch cannot be stepped, or could not.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StepError {
    /// An array of another size.
    #[error("{what} has {found} numbers, expected {expected}")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its numbers.
        found: usize,
        /// Those of the batch.
        expected: usize,
    },
    /// An action is no number; nothing has changed.
    #[error(
        "environment {env}, agent {agent}: action {action} is {value}, expected a finite number"
    )]
    Action {
        /// Index of the environment in the batch.
        env: usize,
        /// The agent.
        agent: usize,
        /// Which of its actions.
        action: usize,
        /// The value.
        value: f32,
    },
    /// There is no episode yet.
    #[error("no episode has begun yet: reset first")]
    NotBegun,
    /// The episode is over.
    #[error("the episode is over after {steps} steps: reset first")]
    Over {
        /// Its steps.
        steps: usize,
    },
    /// The step before failed or was left in its middle, so that environments are at different steps.
    #[error("the step before was not finished: reset first")]
    Unfinished,
    /// The executor gave up in the middle.
    #[error("the step was left in its middle: reset first")]
    Stopped,
    /// Random numbers have no addresses that far.
    #[error("environment {last} does not exist: random numbers are addressed for 2³² of them")]
    NoSuchEnvironment {
        /// The last one asked for.
        last: u64,
    },
    /// An environment diverged.
    #[error(transparent)]
    Episode(#[from] EpisodeError),
}
