//! What a learner consists of.

use proto::Digest;
use proto::config::{Run, TaskName};
use proto::layout::{Dimensions, SnapshotHeader};

use super::ports::Ports;
use crate::algorithm::Algorithm;
use crate::state::TrainingState;
use crate::state::image::Image;
use crate::threads::KeptThreads;

/// The process: what trains, and what talks.
pub(super) struct Learner {
    pub(super) trainer: Trainer,
    pub(super) ports: Ports,
    pub(super) image: Image,
    pub(super) dimensions: Dimensions,
    pub(super) task: TaskName,
    pub(super) run: Run,
    pub(super) digest: Digest,
}

/// What the training thread borrows, and that thread.
pub(super) struct Trainer {
    pub(super) algorithm: Algorithm,
    pub(super) state: TrainingState,
    pub(super) thread: KeptThreads,
}

impl Learner {
    /// Copies the state; its pieces are sent while training goes on. Whoever asks again while it is on
    /// its way gets this one.
    pub(super) fn take_snapshot(&mut self) {
        let Self { trainer: Trainer { state, .. }, ports, image, digest, .. } = self;
        let header = SnapshotHeader {
            iteration: state.iteration,
            digest: digest.0,
            ..SnapshotHeader::default()
        };
        ports.outbox.put(header, |bytes| image.write(state, bytes));
    }
}
