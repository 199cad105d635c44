//! What becomes of what agents say, where arms go to goal postures by themselves.

use super::arm::Posture;
use crate::scalar::Real;
use crate::task::Task;

/// How the joints of a lane group act (residual policy learning; Silver et al. 2018, Johannink et al. 2019).
#[derive(Debug, Clone)]
pub(crate) struct Guidance<S> {
    /// The way to the goal postures, which is added to what agents say, one a joint.
    added: Vec<S>,
    /// Share of what agents say, one a joint.
    share: Vec<S>,
}

impl<S: Real> Guidance<S> {
    /// None: all that agents say, and nothing else.
    pub(crate) fn none(n_joints: usize) -> Self {
        Self { added: vec![S::zero(); n_joints], share: vec![S::one(); n_joints] }
    }

    /// Becomes that to the postures of `arms`, as `task` has it; `scale` is the factor from an action to a rate, and actions stay within `limits`.
    #[inline(always)]
    pub(crate) fn look(&mut self, arms: &[Posture<S>], task: &Task, scale: f64, limits: &[S]) {
        let factor = task.posture.gain / (task.control_period * scale);
        for (index, arm) in arms.iter().enumerate() {
            let joints = task.joints.of_arm(index);
            arm.rates(factor, &limits[joints.clone()], &mut self.added[joints.clone()]);
            if let Some(fade) = task.posture.fades() {
                let mut farthest = S::zero();
                for left in arm.left() {
                    farthest = farthest.max(left.abs());
                }
                self.share[joints].fill((farthest / S::splat(fade)).min(S::one()));
            }
        }
    }

    /// What `joint` does, before clipping, where its agent says so much.
    #[inline(always)]
    pub(crate) fn act(&self, joint: usize, said: S) -> S {
        self.share[joint].mul_add(said, self.added[joint])
    }
}
