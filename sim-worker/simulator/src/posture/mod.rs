//! Goal postures: the joint angles that bring each hand to its goal, as a task tells them to its agents.
//!
//! A pose can be reached in up to eight ways, and near the borders between them an actor that sees the pose alone averages. A goal posture
//! is one way: chosen when the goal is seen for the first time, then kept, while steps of damped least squares in every control step let it follow
//! the base, which carries goals away from the arm or to it. Where the posture does not bring the hand to its goal, or stops a joint, another
//! way is looked for in every control step.

mod chain;
mod foresight;
mod search;

use std::sync::Arc;

use self::chain::{Angles, Chain, Frame, seen_from};
use self::foresight::Foresight;
use self::search::{Question, STARTS, STOPPED, UNSOLVED};
use crate::robot::{JOINTS_PER_ARM, MAX_ARMS, Robot};
use crate::scalar::{Mask, Real};
use crate::spatial::{Vec3, euler_xyz_to_rotation, quaternion_to_rotation};
use crate::task::{Goals, Readings, Task};

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
    pub(crate) free: S,
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
    robot: Arc<Robot>,
    pace: Pace<S>,
    /// Where the base was when they last followed it: who looks twice sees the same.
    base: [S; 7],
}

/// How fast arms go to their postures.
#[derive(Debug, Clone)]
struct Pace<S> {
    /// Share of the way that is left which a control step covers.
    gain: f64,
    /// Time of a control step (s).
    period: f64,
    /// Fastest joint rates (rad/s), arm-major.
    limits: Vec<S>,
}

/// Where the robot is.
struct Place<'a, S> {
    position: Vec3<S>,
    quaternion: [S; 4],
    q: &'a [S],
}

impl<S: Real> Place<'_, S> {
    /// A goal seen from the base.
    #[inline(always)]
    fn seen(&self, [x, y, z, a, b, c]: &[S; 6]) -> Frame<S> {
        let base = quaternion_to_rotation(&self.quaternion);
        let rotation = euler_xyz_to_rotation([*a, *b, *c]);
        seen_from((&base, self.position), &rotation, [*x, *y, *z])
    }

    /// The joint angles of an arm.
    #[inline(always)]
    fn stands(&self, arm: usize) -> Angles<S> {
        let mut stands = [S::zero(); JOINTS_PER_ARM];
        stands.copy_from_slice(&self.q[arm * JOINTS_PER_ARM..][..JOINTS_PER_ARM]);
        stands
    }
}

/// Share of the way that a control step is taken to cover where nothing is added to actions.
const GAIN: f64 = 0.7;

impl<S: Real> Postures<S> {
    /// None yet.
    pub(crate) fn new(robot: &Robot, task: &Task) -> Self {
        let arms = (0..robot.n_arms).map(|arm| Posture::new(Chain::new(robot, arm)));
        let gain = if task.posture.gain > 0.0 { task.posture.gain } else { GAIN };
        let limit = |limit: &f64| S::splat(limit * task.action_scale);
        let limits = task.action_limit.iter().map(limit).collect();
        Self {
            arms: arms.collect(),
            robot: Arc::new(robot.clone()),
            pace: Pace { gain, period: task.control_period, limits },
            base: [S::splat(f64::NAN); 7],
        }
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
        let ([x, y, z], [q0, q1, q2, q3]) = (readings.base_position, readings.base_quaternion);
        let now = [x, y, z, q0, q1, q2, q3];
        let rests = equal(&now, &self.base);
        self.base = now;
        let place = Place {
            position: readings.base_position,
            quaternion: readings.base_quaternion,
            q: &readings.q,
        };
        let mut open = [S::Mask::splat(false); MAX_ARMS];
        let mut any = false;
        for (index, (arm, goal)) in self.arms.iter_mut().zip(&goals.hands).enumerate() {
            open[index] = arm.begin(goal, &place, index);
            any |= open[index].any();
        }
        if any {
            let Self { arms, robot, pace, .. } = self;
            let open = &open[..arms.len()];
            Foresight { robot, pace, goals: &goals.hands, place: &place, open }.choose(arms);
        }
        for (index, (arm, goal)) in self.arms.iter_mut().zip(&goals.hands).enumerate() {
            arm.follow(goal, (&place, rests & !open[index]), index);
        }
    }

    /// Writes the actions that go there by themselves, one a joint, within `limits`; `scale` is the factor from an action to a rate.
    #[inline(always)]
    pub(crate) fn guide(&self, gain: f64, scale: f64, limits: &[S], out: &mut [S]) {
        let factor = gain / (self.pace.period * scale);
        let arms = self.arms.iter().zip(limits.chunks_exact(JOINTS_PER_ARM));
        for ((arm, limits), out) in arms.zip(out.chunks_exact_mut(JOINTS_PER_ARM)) {
            arm.rates(factor, limits, out);
        }
    }
}

impl<S: Real> Posture<S> {
    fn new(chain: Chain<S>) -> Self {
        let angles = chain.home;
        let (zero, goal) = (S::zero(), [S::splat(f64::NAN); 6]);
        let left = [zero; JOINTS_PER_ARM];
        Self { left, good: zero, free: zero, chain, goal, angles, tried: zero }
    }

    /// Looks for a posture where the goal is a new one; says where it is.
    #[inline(always)]
    fn begin(&mut self, goal: &[S; 6], place: &Place<'_, S>, index: usize) -> S::Mask {
        let new = !equal(goal, &self.goal);
        if new.any() {
            let (target, stands) = (place.seen(goal), place.stands(index));
            let question = Question { chain: &self.chain, target: &target, stands: &stands };
            choose(new, question.search(), &mut self.angles);
            self.tried = S::select(new, S::splat(STARTS as f64), self.tried);
            self.goal = *goal;
        }
        new
    }

    /// Follows the base, but in lanes where it `rests`.
    #[inline(always)]
    fn follow(&mut self, goal: &[S; 6], (place, rests): (&Place<'_, S>, S::Mask), index: usize) {
        let Self { chain, good, free, angles, tried, .. } = self;
        let (target, stands) = (place.seen(goal), place.stands(index));
        let question = Question { chain, target: &target, stands: &stands };
        let before = *angles;
        for _ in 0..FOLLOWING {
            *angles = chain.approach(&target, angles).0;
        }
        // Angles that only come near would wander with the base.
        let mut cost = question.cost(angles);
        let cost_before = question.cost(&before);
        let astray = cost.ge(S::splat(UNSOLVED)) & cost_before.le(cost);
        choose(astray, before, angles);
        cost = S::select(astray, cost_before, cost);
        let bad = !rests & cost.ge(S::splat(STOPPED));
        if bad.any() {
            *tried = S::select(bad, *tried + S::one(), *tried);
            let other = question.later(*tried);
            let other_cost = question.cost(&other);
            let better = bad & other_cost.lt(S::splat(STOPPED));
            choose(better, other, angles);
            cost = S::select(better, other_cost, cost);
        }
        choose(rests, before, angles);
        let is_good = S::select(cost.lt(S::splat(STOPPED)), S::one(), S::zero());
        *good = S::select(rests, *good, is_good);
        *free = S::select(chain.is_stopped(angles), S::zero(), S::one());
        for joint in 0..JOINTS_PER_ARM {
            self.left[joint] = self.chain.way(joint, stands[joint], self.angles[joint]);
        }
    }

    /// `factor` times what is left to go, all joints in proportion, within `limits`; nothing where a joint would be stopped.
    #[inline(always)]
    fn rates(&self, factor: f64, limits: &[S], out: &mut [S]) {
        let factor = S::splat(factor) * self.free;
        let mut excess = S::one();
        for ((left, limit), out) in self.left.iter().zip(limits).zip(&mut *out) {
            *out = factor * *left;
            excess = excess.max(out.abs() / *limit);
        }
        for out in out {
            *out = *out / excess;
        }
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
