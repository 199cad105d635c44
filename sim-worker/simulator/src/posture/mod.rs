//! Goal postures: the joint angles that bring each hand to its goal, as a task tells them to its agents.
//!
//! A pose can be reached in up to eight ways, and near the borders between them an actor that sees the pose alone averages. A goal posture
//! is one way: chosen when the goal is seen for the first time, then kept, while steps of damped least squares in every control step let it follow
//! the base, which carries goals away from the arm or to it. Where the posture does not bring the hand to its goal, or stops a joint, another
//! way is looked for in every control step.

mod chain;
mod search;

use self::chain::{Angles, Chain, Frame, seen_from};
use self::search::{Question, STARTS, STOPPED, UNSOLVED};
use crate::robot::{JOINTS_PER_ARM, Robot};
use crate::scalar::{Mask, Real};
use crate::spatial::{euler_xyz_to_rotation, quaternion_to_rotation};
use crate::task::{Goals, Readings};

/// Steps with which a posture follows the base in a control step.
const FOLLOWING: usize = 2;

/// The goal posture of one arm.
#[derive(Debug, Clone)]
pub(crate) struct Posture<S> {
    /// What is left to go, a joint each (rad).
    pub(crate) left: Angles<S>,
    /// One where the posture brings the hand to its goal and no joint is stopped there, else zero.
    pub(crate) good: S,
    /// One where no joint is stopped there, else zero.
    free: S,
    chain: Chain<S>,
    /// The goal that the angles lead to.
    goal: [S; 6],
    angles: Angles<S>,
    /// Starts of the search that were tried.
    tried: S,
}

/// The goal postures of one lane group.
#[derive(Debug, Clone)]
pub(crate) struct Postures<S> {
    pub(crate) arms: Vec<Posture<S>>,
    /// Where the base was when they last followed it: who looks twice sees the same.
    base: [S; 7],
}

impl<S: Real> Postures<S> {
    /// None yet.
    pub(crate) fn new(robot: &Robot) -> Self {
        let arms = (0..robot.n_arms).map(|arm| Posture::new(Chain::new(robot, arm)));
        Self { arms: arms.collect(), base: [S::splat(f64::NAN); 7] }
    }

    /// Forgets all goals, because another episode begins.
    pub(crate) fn forget(&mut self) {
        for arm in &mut self.arms {
            arm.goal = [S::splat(f64::NAN); 6];
        }
    }

    /// Looks for postures of new goals, and has the others follow the base.
    #[inline(always)]
    pub(crate) fn update(&mut self, readings: &Readings<S>, goals: &Goals<S>) {
        let base = quaternion_to_rotation(&readings.base_quaternion);
        let ([x, y, z], [q0, q1, q2, q3]) = (readings.base_position, readings.base_quaternion);
        let now = [x, y, z, q0, q1, q2, q3];
        let rests = equal(&now, &self.base);
        self.base = now;
        for (index, (arm, goal)) in self.arms.iter_mut().zip(&goals.hands).enumerate() {
            let [x, y, z, a, b, c] = *goal;
            let rotation = euler_xyz_to_rotation([a, b, c]);
            let target = seen_from((&base, readings.base_position), &rotation, [x, y, z]);
            let mut stands = [S::zero(); JOINTS_PER_ARM];
            stands.copy_from_slice(&readings.q[index * JOINTS_PER_ARM..][..JOINTS_PER_ARM]);
            arm.follow(goal, (&target, rests), &stands);
            for joint in 0..JOINTS_PER_ARM {
                arm.left[joint] = arm.chain.way(joint, stands[joint], arm.angles[joint]);
            }
        }
    }

    /// Writes the actions that go there by themselves: `factor` times what is left, all joints of an arm in proportion, within `limits`; none where a
    /// joint would be stopped.
    #[inline(always)]
    pub(crate) fn guide(&self, factor: S, limits: &[S], out: &mut [S]) {
        let arms = self.arms.iter().zip(limits.chunks_exact(JOINTS_PER_ARM));
        for ((arm, limits), out) in arms.zip(out.chunks_exact_mut(JOINTS_PER_ARM)) {
            let mut excess = S::one();
            for ((left, limit), out) in arm.left.iter().zip(limits).zip(&mut *out) {
                *out = factor * *left * arm.free;
                excess = excess.max(out.abs() / *limit);
            }
            for out in out {
                *out = *out / excess;
            }
        }
    }
}

/// Factor from what is left to an action, where a control step of `period` (s) shall cover the share `gain` of it and
/// commands are `scale` times actions.
pub(crate) fn guiding(gain: f64, period: f64, scale: f64) -> f64 {
    gain / (period * scale)
}

impl<S: Real> Posture<S> {
    fn new(chain: Chain<S>) -> Self {
        let angles = chain.home;
        let (zero, goal) = (S::zero(), [S::splat(f64::NAN); 6]);
        Self {
            left: [zero; JOINTS_PER_ARM],
            good: zero,
            free: zero,
            chain,
            goal,
            angles,
            tried: zero,
        }
    }

    #[inline(always)]
    fn follow(&mut self, goal: &[S; 6], (target, rests): (&Frame<S>, S::Mask), stands: &Angles<S>) {
        let same = equal(goal, &self.goal);
        let kept = same & rests;
        if kept.all() {
            return;
        }
        let Self { chain, good, free, angles, tried, .. } = self;
        let question = || Question { chain, target, stands };
        let before = *angles;
        if !same.all() {
            choose(!same, question().search(), angles);
            *tried = S::select(same, *tried, S::splat(STARTS as f64));
            self.goal = *goal;
        }
        for _ in 0..FOLLOWING {
            *angles = chain.approach(target, angles).0;
        }
        let mut cost = question().cost(angles);
        let bad = !kept & cost.ge(S::splat(STOPPED));
        if bad.any() {
            *tried = S::select(bad, *tried + S::one(), *tried);
            let other = question().later(*tried);
            let other_cost = question().cost(&other);
            let better = bad & other_cost.lt(cost.min(S::splat(UNSOLVED)));
            choose(better, other, angles);
            cost = S::select(better, other_cost, cost);
        }
        choose(kept, before, angles);
        let is_good = S::select(cost.lt(S::splat(STOPPED)), S::one(), S::zero());
        *good = S::select(kept, *good, is_good);
        *free = S::select(chain.is_stopped(angles), S::zero(), S::one());
    }
}

/// Puts `these` in where the mask is set.
#[inline(always)]
fn choose<S: Real>(mask: S::Mask, these: Angles<S>, angles: &mut Angles<S>) {
    for (angle, this) in angles.iter_mut().zip(these) {
        *angle = S::select(mask, this, *angle);
    }
}

/// Where all numbers are the same; nothing is the same as NaN.
#[inline(always)]
fn equal<S: Real, const N: usize>(a: &[S; N], b: &[S; N]) -> S::Mask {
    let mut equal = S::Mask::splat(true);
    for (a, b) in a.iter().zip(b) {
        equal = equal & a.le(*b) & a.ge(*b);
    }
    equal
}

#[cfg(test)]
mod tests;
