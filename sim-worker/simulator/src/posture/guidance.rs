//! What becomes of what agents say, where arms go to goal postures by themselves.

use super::Postures;
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

    /// Becomes that to `postures`, as `task` has it; `scale` is the factor from an action to a rate, and actions stay within `limits`.
    #[inline(always)]
    pub(crate) fn look(&mut self, postures: &Postures<S>, task: &Task, scale: f64, limits: &[S]) {
        let factor = task.posture.gain / (task.control_period * scale);
        for (index, arm) in postures.arms.iter().enumerate() {
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

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset, TaskName};

    use super::*;
    use crate::env::readings;
    use crate::posture::Pace;
    use crate::robot::Robot;
    use crate::state::State;

    /// What joints do where agents say 0.5 each: arm 2 has 0.06 rad and less to go, the others are at their goals.
    fn acted(gain: f64, fade: f64) -> (Vec<f64>, Vec<f64>) {
        let robot = Robot::builtin("paper").expect("built in");
        let config = Layers::new(Preset::Guided, Some(TaskName::Trajectory)).resolve();
        let mut config = config.expect("a preset");
        config.task.posture.gain = gain;
        config.task.posture.fade = fade;
        let task = crate::rollout::World::new(&config, &robot).task;

        let home = State::<f64>::home(&robot);
        let mut there = home.clone();
        for (joint, q) in there.q[6..12].iter_mut().enumerate() {
            *q += 0.06 - 0.01 * joint as f64;
        }
        let pose = |hand: &crate::task::HandReading<f64>| {
            let ([x, y, z], [a, b, c]) = (hand.position, hand.euler);
            [x, y, z, a, b, c]
        };
        let goals: Vec<_> = readings(&robot, &there).hands.iter().map(pose).collect();
        let pace = Pace { gain: 0.7, period: task.control_period, limits: vec![2.0; 24] };
        let mut postures = Postures::new(&robot, pace, 1.0);
        postures.update((home.base_position, home.base_quaternion), &home.q, &goals);
        let left = postures.arms.iter().flat_map(|arm| arm.left().to_vec()).collect();

        let mut guidance = Guidance::none(24);
        guidance.look(&postures, &task, task.action_scale, &[1.0; 24]);
        (left, (0..24).map(|joint| guidance.act(joint, 0.5)).collect())
    }

    #[test]
    fn what_agents_say_counts_less_near_their_goals() {
        let (left, all) = acted(0.7, 0.0);
        assert!((left[6] - 0.06).abs() < 1e-4 && left[0].abs() < 1e-4, "{left:?}");
        let task_factor = 0.7 / (0.4 * 0.8);
        for (acted, left) in all.iter().zip(&left) {
            assert!((acted - (0.5 + task_factor * left)).abs() < 1e-9, "{acted}, {left} left");
        }
        for (fade, share) in [(0.1, 0.6), (0.05, 1.0)] {
            let (_, faded) = acted(0.7, fade);
            for joint in 0..24 {
                let said = if (6..12).contains(&joint) { share * 0.5 } else { 0.0 };
                let wanted = said + task_factor * left[joint];
                assert!((faded[joint] - wanted).abs() < 1e-3, "joint {joint}: {}", faded[joint]);
            }
        }
        // Nobody else goes there.
        assert_eq!(acted(0.0, 0.1).1, [0.5; 24]);
    }
}
