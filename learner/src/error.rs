//! What can go wrong in the learner.

use channels::ChannelError;
use proto::{ConfigError, ExitCode, ExitError};

/// An error of the learner. Every message says what was expected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnerError {
    /// A received block holds a number that is not finite.
    #[error(
        "worker {worker} (incarnation {incarnation}) sent a block of iteration {iteration}, \
         shard {shard}, whose {array} is {value} at {place}; nothing was trained on it"
    )]
    BadBlock {
        /// Who rolled it out.
        worker: u32,
        /// How often that worker had been started before.
        incarnation: u32,
        /// The iteration.
        iteration: u64,
        /// The shard.
        shard: u32,
        /// The array of the block.
        array: &'static str,
        /// The number.
        value: f32,
        /// Agent, environment and step.
        place: String,
    },
    /// A received block does not fit this run.
    #[error("worker {worker} sent a block whose {what} is {found}, expected {expected}")]
    ForeignBlock {
        /// Who rolled it out.
        worker: u32,
        /// The field.
        what: &'static str,
        /// What it says.
        found: u64,
        /// What it should say.
        expected: String,
    },
    /// The same block was rolled out twice with different results.
    #[error(
        "two blocks of iteration {iteration}, shard {shard} differ (workers {} and {}): \
         a rollout must depend on nothing but its order; do all workers run the same program?",
        workers[0], workers[1]
    )]
    Impure {
        /// The iteration.
        iteration: u64,
        /// The shard.
        shard: u32,
        /// Who rolled it out.
        workers: [u32; 2],
    },
    /// A loss or a gradient is not finite.
    #[error(
        "the {network} gradient of agent {agent} is not finite in iteration {iteration}, {place}; lower the learning rate, \
         or set algorithm.max_grad_norm to a small number above 0 (0 turns it off)"
    )]
    Diverged {
        /// `actor` or `critic`.
        network: &'static str,
        /// The agent.
        agent: usize,
        /// The iteration.
        iteration: u64,
        /// Which optimiser step of it, in words.
        place: String,
    },
    /// Parameters are not finite after an update.
    #[error(
        "the {network} of agent {agent} holds {what} after iteration {iteration}; lower the learning rate, \
         or set algorithm.max_grad_norm to a small number above 0 (0 turns it off). The checkpoints of before are as they were"
    )]
    Unbounded {
        /// `actor` or `critic`.
        network: &'static str,
        /// The agent, or the first of those whose it is.
        agent: usize,
        /// What has no bounds.
        what: &'static str,
        /// The iteration.
        iteration: u64,
    },
    /// A training state cannot be restored.
    #[error("training state: {0}")]
    State(String),
    /// The configuration of the run does not say which arithmetic it is trained with.
    #[error(
        "run.precision is `auto`, expected `f32` or `bf16`: `octopus train` decides it when a run begins, \
         and `octopus resume` in a run of an earlier version"
    )]
    Undecided,
    /// The device is not there.
    #[error("{0}")]
    Device(String),
    /// A channel fails.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A file cannot be read.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// The file.
        path: std::path::PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A robot file cannot be used.
    #[error("{0}")]
    Robot(String),
}

impl From<LearnerError> for ExitError {
    fn from(error: LearnerError) -> Self {
        let code = match &error {
            LearnerError::State(_) => ExitCode::RunDirectory,
            LearnerError::Device(_) | LearnerError::Channel(ChannelError::Full { .. }) => {
                ExitCode::Environment
            }
            LearnerError::Config(_)
            | LearnerError::File { .. }
            | LearnerError::Robot(_)
            | LearnerError::Undecided => ExitCode::BadInput,
            _ => ExitCode::Failure,
        };
        Self::new(code, error.to_string())
    }
}
