//! Episodes in lanes: one group of them.

use std::ops::Range;

use crate::collision::Touching;
use crate::env::{EpisodeError, check_means};
use crate::scalar::Real;
use crate::state::State;
use crate::task::{Errors, Goals, Readings};

/// One lane group.
#[derive(Clone)]
pub(super) struct Group<S: Real> {
    pub(super) state: State<S>,
    /// What is, and what the policies see of it.
    pub(super) readings: Readings<S>,
    pub(super) seen: Readings<S>,
    pub(super) goals: Goals<S>,
    /// Of what is, and of what is seen.
    pub(super) errors: Errors<S>,
    pub(super) seen_errors: Errors<S>,
    /// What touched when it was last read.
    pub(super) touching: Option<Touching<S>>,
    /// Clipped actions, one a joint.
    pub(super) action: Vec<S>,
    /// What is executed (rad/s).
    pub(super) command: Vec<S>,
    /// Commands that wait, the oldest first: as many as control steps lie between an action and its execution.
    pub(super) waiting: Vec<Vec<S>>,
}

impl<S: Real> Group<S> {
    /// Has commands wait for so many control steps. Where that is more than before, the last one holds until something new arrives; where it is less, the oldest
    /// that wait are left out.
    pub(super) fn delay(&mut self, steps: usize) {
        let surplus = self.waiting.len().saturating_sub(steps);
        self.waiting.drain(..surplus);
        let last = self.waiting.last().unwrap_or(&self.command).clone();
        self.waiting.resize(steps, last);
    }

    /// Has an agent's joints do in the next step what was decided, clipped at their limits.
    ///
    /// # Errors
    /// If it is no number; `env` is the first lane's episode.
    #[inline(always)]
    pub(super) fn act(
        &mut self,
        agent: usize,
        joints: Range<usize>,
        means: &[S],
        limits: &[S],
        (env, step): (u32, usize),
    ) -> Result<(), EpisodeError> {
        if let Err(error) = check_means(means, env, step, agent) {
            let Self { state, goals, command, .. } = self;
            return Err(error.keep(env, state, goals, command));
        }
        for (joint, mean) in joints.zip(means) {
            self.action[joint] = mean.clamp(-limits[joint], limits[joint]);
        }
        Ok(())
    }
}
