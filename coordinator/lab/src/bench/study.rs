//! What is asked of a measurement.

use std::path::PathBuf;

use proto::config::Preset;

use crate::scale::Scale;

/// What `octopus train` trains unless told otherwise.
pub const TRAINED: Preset = Preset::DEFAULT;

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// Everything but Python, growth and scale.
    All,
    /// The simulator alone.
    Physics,
    /// Whole rollouts.
    Rollout,
    /// Updates.
    Learner,
    /// A block from a worker to the learner.
    Transport,
    /// A whole training.
    Train,
    /// Batches of the module for Python.
    Python,
    /// How the figures change with sizes.
    Growth,
    /// How a training grows with machines, simulated.
    Scale,
}

/// What is asked of a measurement.
#[derive(Debug, Clone)]
pub struct Study {
    /// What is measured.
    pub subject: Subject,
    /// The configuration to start from.
    pub preset: Preset,
    /// Keys that are changed, `key=value`.
    pub sets: Vec<String>,
    /// Workers of a training.
    pub workers: u64,
    /// How long each figure is measured (s).
    pub seconds: f64,
    /// The Python that has the peers, if these are measured, too.
    pub peers: Option<PathBuf>,
    /// The machines of `scale`.
    pub scale: Scale,
    /// What gateways take at the learner and at a host (ms of a core for a MB).
    pub gateways: [f64; 2],
    /// Where pictures of growth go.
    pub pictures: Option<PathBuf>,
    /// Whether pictures may replace what others made.
    pub force: bool,
}
