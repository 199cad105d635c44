//! The rollout loop: many environments at once through whole episodes with a policy that explores.
//!
//! Rows of a block are written straight into the caller's memory, which is a loaned sample of shared
//! memory in a worker: turning lanes into rows is the write itself, there is no other copy.

use super::batch::{Episodes, Stage};
use super::running::Running;
use crate::env::EpisodeError;
use crate::scalar::{LaneFn, Real};

impl LaneFn for Episodes<'_> {
    type Output = Result<(), EpisodeError>;

    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let n_steps = self.batch.n_steps;
        let (mut running, on_stage) = Running::<S>::new(self);
        for step in 0..=n_steps {
            running.observe(step);
            on_stage(Stage::Observed);
            if step == n_steps {
                break;
            }
            running.decide(step)?;
            on_stage(Stage::Decided);
            running.advance(step)?;
            on_stage(Stage::Moved);
        }
        Ok(())
    }
}
