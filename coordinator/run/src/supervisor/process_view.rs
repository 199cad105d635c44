//! How a process of a run looks from outside.

use proto::message::WorkerId;
use service::live::Role;

/// A process of the run, for its status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProcessView {
    /// What it does.
    pub role: Role,
    /// Which worker it is, if it is one.
    pub worker: Option<WorkerId>,
    /// Process id; none while a successor waits for its back-off.
    pub pid: Option<u32>,
    /// How often it has died and been replaced.
    pub replaced: u32,
    /// Whether it has been asked to go.
    pub leaving: bool,
}
