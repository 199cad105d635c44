//! What a learner consists of.

use proto::Digest;
use proto::config::{Run, TaskName};
use proto::layout::{Dimensions, SnapshotHeader};

use super::ports::{Outgoing, Ports};
use crate::algorithm::Algorithm;
use crate::state::TrainingState;
use crate::state::image::Image;

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

/// What the training thread borrows.
pub(super) struct Trainer {
    pub(super) algorithm: Algorithm,
    pub(super) state: TrainingState,
}

impl Learner {
    /// Copies the state; its pieces are sent while training goes on. Whoever asks again while it is on
    /// its way gets this one.
    pub(super) fn take_snapshot(&mut self) {
        let state = &self.trainer.state;
        if self.ports.outbox.back().is_some_and(|last| last.header.iteration == state.iteration) {
            return;
        }
        let header = SnapshotHeader {
            iteration: state.iteration,
            digest: self.digest.0,
            ..SnapshotHeader::default()
        };
        let mut bytes = std::mem::take(&mut self.ports.spare);
        self.image.write(state, &mut bytes);
        self.ports.outbox.push_back(Outgoing { header, bytes });
    }
}
