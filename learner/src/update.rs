//! What every algorithm is to the learner.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use crate::LearnerError;
use crate::report::UpdateReport;
use crate::state::TrainingState;

/// Makes an update of an iteration's samples.
pub trait Update {
    /// What an update can record of what it computed, for tests.
    type Trace;

    /// A counter that grows with every part of an update, however many samples an iteration has, to be watched from
    /// another thread: while an update is under way and it stands still, nothing is computed.
    fn work(&self) -> Arc<AtomicU64>;

    /// Trains `state` on the blocks of one iteration, ordered by shard.
    ///
    /// # Errors
    /// If a gradient is not finite; `state` is then worthless and must not be published.
    fn update(
        &mut self,
        state: &mut TrainingState,
        shards: &[&[f32]],
    ) -> Result<UpdateReport, LearnerError> {
        self.update_traced(state, shards, None)
    }

    /// [`Self::update`] that also records what it computed, if asked to.
    fn update_traced(
        &mut self,
        state: &mut TrainingState,
        shards: &[&[f32]],
        trace: Option<&mut Self::Trace>,
    ) -> Result<UpdateReport, LearnerError>;
}
