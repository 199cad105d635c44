//! The numbers a critic sees.
//!
//! * `concatenated`: the observations of all agents, one after the other, A · O numbers.
//! * `compact`: every quantity once: base 13 (angular velocity in its own axes, the rest in the world's), and errors in the base's; where
//!   the base has a goal its errors, plain 3 and squashed 6; then for each arm its joint angles
//!   (6, or as sines and cosines 12) and rates 6, where hands have goals its hand's errors, plain 6 and
//!   squashed 12, and how the goal moves, and its last action 6.
//! * `own`: nothing; each critic sees its agent's observation.

use proto::config::CriticState;

use super::observation::Writer;
use super::{Errors, Readings, Task};
use crate::scalar::{Kernel, Real};

/// Writes the critic state into `out` (length S); `observations` is `[A][O]`.
#[inline(always)]
pub fn critic_state<S: Real>(
    task: &Task,
    readings: &Readings<S>,
    errors: &Errors<S>,
    observations: &[S],
    out: &mut [S],
) {
    S::compiled(Critic { task, readings, errors, observations, out });
}

struct Critic<'a, S: Real> {
    task: &'a Task,
    readings: &'a Readings<S>,
    errors: &'a Errors<S>,
    observations: &'a [S],
    out: &'a mut [S],
}

impl<S: Real> Kernel<S> for Critic<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { task, readings, errors, observations, out } = self;
        let mut out = Writer::new(out);
        match task.critic_state {
            CriticState::Own => {}
            CriticState::Concatenated => out.put(observations),
            CriticState::Compact => {
                out.put_base(task, readings);
                if task.name.turns() {
                    out.put(&errors.seen_base);
                    out.put(&errors.squashed_base);
                }
                for arm in 0..task.n_arms() {
                    out.put_joints(task, readings, arm);
                    if task.name.reaches() {
                        out.put_hand(task, errors, arm);
                        out.put_posture(task, errors, arm);
                    }
                    out.put_action(task, readings, arm);
                }
            }
        }
        out.finish();
    }
}
