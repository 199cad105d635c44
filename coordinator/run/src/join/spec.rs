//! What it takes to join a run, and how that ends.

use std::path::PathBuf;
use std::time::Duration;

use crate::signals::StopRequests;
use crate::supervisor::Programs;

/// What is needed to join.
#[derive(Debug)]
pub struct JoinSpec {
    /// Where the run is: `quic/HOST:PORT` or `tcp/ADDRESS:PORT`.
    pub endpoint: String,
    /// Certificates, for `quic`.
    pub certificates: Option<PathBuf>,
    /// Workers of this machine.
    pub workers: usize,
    /// What it calls itself.
    pub name: String,
    /// How long the run may be silent.
    pub wait: Duration,
    /// The program `gateway`.
    pub gateway: PathBuf,
    /// The program of the workers.
    pub programs: Programs,
    /// Ctrl-C.
    pub stop: StopRequests,
}

/// Why this machine helps no longer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Left {
    /// The run is over.
    Over,
    /// Ctrl-C.
    Asked,
}

/// How a membership ended.
pub(super) enum Ended {
    Left(Left),
    /// The run goes on, or may; here is what happened.
    Lost(String),
}
