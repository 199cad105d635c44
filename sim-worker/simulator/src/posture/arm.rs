//! The goal posture of one arm: chosen, followed, gone to.

use super::chain::{Angles, Chain, Frame, LEAST_DAMPING, choose, everywhere, seen_from};
use super::search::{Question, STARTS, STOPPED, UNSOLVED};
use crate::robot::{Joints, MAX_JOINTS_PER_ARM};
use crate::scalar::{Mask, Real};
use crate::spatial::{Vec3, euler_xyz_to_rotation, quaternion_to_rotation};
use crate::state::State;

/// Steps with which a posture follows the base in a control step.
const FOLLOWING: usize = 2;
/// A goal that has moved by less than this since it was last seen is followed, another one is looked for anew: position (m) and Euler angles (rad), each.
const SAME: [f64; 2] = [0.05, 0.1];

/// The goal posture of one arm.
#[derive(Debug, Clone)]
pub(crate) struct Posture<S: Real> {
    /// What is left to go, a joint each (rad); zero behind the arm's last.
    left: Angles<S>,
    /// One where the posture brings the hand to its goal and no joint is stopped there, else zero.
    pub(crate) good: S,
    /// One where no joint is stopped there, else zero.
    pub(crate) free: S,
    pub(super) chain: Chain<S>,
    /// The goal that the angles lead to.
    goal: [S; 6],
    pub(super) angles: Angles<S>,
    /// Starts of the search that were tried.
    pub(super) tried: S,
}

/// How fast arms go to their postures.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pace<S> {
    /// Share of the way that is left which a control step covers.
    pub(crate) gain: f64,
    /// Time of a control step (s).
    pub(crate) period: f64,
    /// Fastest joint rates (rad/s), arm-major.
    pub(crate) limits: Vec<S>,
}

/// How postures follow their goals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Following {
    /// Damping that remains at the goal.
    damping: f64,
    /// By how much a posture may miss its goal (m and rad, together) without being given up.
    near: f64,
}

impl Following {
    /// As closely as they can.
    pub(super) const CLOSE: Self = Self { damping: LEAST_DAMPING, near: 0.0 };
    /// Goals that tremble, because the base is read badly. Near singular poses angles would jump with them, and a goal that seems out of reach for a moment would have another way looked for.
    pub(super) const STEADY: Self = Self { damping: 1e-2, near: 0.02 };

    /// Where angles of this cost do not bring the hand to its goal, but near enough.
    #[inline(always)]
    fn is_near<S: Real>(self, cost: S) -> S::Mask {
        cost.ge(S::splat(UNSOLVED)) & cost.lt(S::splat(UNSOLVED + self.near))
    }
}

/// A posture on the way after its goal, from [`Posture::go_after`] to [`Posture::settle`].
#[derive(Debug, Clone, Copy)]
#[must_use = "the posture has to settle"]
pub(super) struct Pursuit<S: Real> {
    /// Where the hand shall go.
    pub(super) target: Frame<S>,
    /// Where the arm's joints stand.
    pub(super) stands: Angles<S>,
    before: Angles<S>,
    /// What is to be said against the angles.
    pub(super) cost: S,
    /// Lanes that need another way.
    pub(super) bad: S::Mask,
    rests: S::Mask,
}

/// Where the robot is.
pub(super) struct Place<'a, S> {
    pub(super) position: Vec3<S>,
    pub(super) quaternion: [S; 4],
    pub(super) q: &'a [S],
    pub(super) joints: Joints,
}

impl<S: Real> Place<'_, S> {
    /// The robot there, at rest.
    #[inline(always)]
    pub(super) fn at_rest(&self) -> State<S> {
        let zero = [S::zero(); 3];
        State {
            base_position: self.position,
            base_quaternion: self.quaternion,
            base_linear_velocity: zero,
            base_angular_velocity: zero,
            q: self.q.to_vec(),
            qd: vec![S::zero(); self.q.len()],
        }
    }
}

#[cfg(test)]
impl<'a, S: Real> Place<'a, S> {
    /// That of a robot in `state`.
    #[inline(always)]
    pub(super) fn of(state: &'a State<S>, joints: Joints) -> Self {
        let (position, quaternion) = (state.base_position, state.base_quaternion);
        Self { position, quaternion, q: &state.q, joints }
    }
}

impl<S: Real> Place<'_, S> {
    /// A goal seen from the base.
    #[inline(always)]
    pub(super) fn seen(&self, [x, y, z, a, b, c]: &[S; 6]) -> Frame<S> {
        let base = quaternion_to_rotation(&self.quaternion);
        let rotation = euler_xyz_to_rotation([*a, *b, *c]);
        seen_from((&base, self.position), &rotation, [*x, *y, *z])
    }

    /// The joint angles of an arm.
    #[inline(always)]
    pub(super) fn stands(&self, arm: usize) -> Angles<S> {
        let mut stands = [S::zero(); MAX_JOINTS_PER_ARM];
        let q = &self.q[self.joints.of_arm(arm)];
        stands[..q.len()].copy_from_slice(q);
        stands
    }
}

impl<S: Real> Posture<S> {
    /// What is left to go, a joint each (rad).
    pub(crate) fn left(&self) -> &[S] {
        &self.left[..self.chain.n_joints()]
    }

    /// Forgets its goal.
    pub(super) fn forget(&mut self) {
        self.goal = [S::splat(f64::NAN); 6];
    }

    pub(super) fn new(chain: Chain<S>) -> Self {
        let angles = chain.home;
        let (zero, goal) = (S::zero(), [S::splat(f64::NAN); 6]);
        let left = [zero; MAX_JOINTS_PER_ARM];
        Self { left, good: zero, free: zero, chain, goal, angles, tried: zero }
    }

    /// Begins anew as the other one with these angles; nobody looks at its goal.
    #[inline(always)]
    pub(super) fn restart_from(&mut self, other: &Self, angles: &Angles<S>) {
        self.angles = *angles;
        self.left = other.left;
        self.good = other.good;
        self.free = other.free;
        self.tried = other.tried;
    }

    /// What it is in lane `lane`, in all lanes of `chain`, which is the same arm.
    #[inline(always)]
    pub(super) fn everywhere<T: Real>(&self, lane: usize, chain: &Chain<T>) -> Posture<T> {
        let of = |x: S| everywhere(x, lane);
        Posture {
            left: self.left.map(of),
            good: of(self.good),
            free: of(self.free),
            chain: chain.clone(),
            goal: self.goal.map(of),
            angles: self.angles.map(of),
            tried: of(self.tried),
        }
    }

    /// Looks for a posture where the goal is a new one; says where it is, and where the goal has not moved at all.
    #[inline(always)]
    pub(super) fn begin(
        &mut self,
        goal: &[S; 6],
        place: &Place<'_, S>,
        index: usize,
    ) -> (S::Mask, S::Mask) {
        let new = !is_near(goal, &self.goal);
        let rests = equal(goal, &self.goal);
        if new.any() {
            let (target, stands) = (place.seen(goal), place.stands(index));
            let question = Question { chain: &self.chain, target: &target, stands: &stands };
            choose(new, question.search(), &mut self.angles);
            self.tried = S::select(new, S::splat(STARTS as f64), self.tried);
        }
        self.goal = *goal;
        (new, rests)
    }

    /// Goes after its goal, which the base carries away, but in lanes where it `rests`.
    #[inline(always)]
    pub(super) fn go_after(
        &mut self,
        goal: &[S; 6],
        (place, rests): (&Place<'_, S>, S::Mask),
        (index, following): (usize, Following),
    ) -> Pursuit<S> {
        let Self { chain, angles, tried, .. } = self;
        let (target, stands) = (place.seen(goal), place.stands(index));
        let question = Question { chain, target: &target, stands: &stands };
        let before = *angles;
        let damping = following.damping;
        let (first, missed) = chain.approach_damped(&target, &before, damping);
        *angles = first;
        for _ in 1..FOLLOWING {
            *angles = chain.approach_damped(&target, angles, damping).0;
        }
        // Angles that only come near would wander with the base.
        let mut cost = question.cost(angles);
        let cost_before = question.cost_of(&before, missed);
        let astray = cost.ge(S::splat(UNSOLVED)) & cost_before.le(cost);
        choose(astray, before, angles);
        cost = S::select(astray, cost_before, cost);
        let bad = !rests & cost.ge(S::splat(STOPPED)) & !following.is_near(cost);
        *tried = S::select(bad, *tried + S::one(), *tried);
        Pursuit { target, stands, before, cost, bad, rests }
    }

    /// Ends a step of [`Posture::go_after`].
    #[inline(always)]
    pub(super) fn settle(&mut self, pursuit: &Pursuit<S>, following: Following) {
        let Self { left, good, free, chain, angles, .. } = self;
        let Pursuit { stands, before, cost, rests, .. } = pursuit;
        choose(*rests, *before, angles);
        let leads_there = cost.lt(S::splat(STOPPED)) | following.is_near(*cost);
        let is_good = S::select(leads_there, S::one(), S::zero());
        *good = S::select(*rests, *good, is_good);
        *free = S::select(chain.is_stopped(angles), S::zero(), S::one());
        for joint in 0..chain.n_joints() {
            left[joint] = chain.way(joint, stands[joint], angles[joint]);
        }
    }

    /// `factor` times what is left to go, all joints in proportion, within `limits`; nothing where a joint would be stopped.
    #[inline(always)]
    pub(super) fn rates(&self, factor: f64, limits: &[S], out: &mut [S]) {
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

/// Where a goal is not far from where it was; nothing is near to NaN.
#[inline(always)]
fn is_near<S: Real>(goal: &[S; 6], was: &[S; 6]) -> S::Mask {
    let mut near = S::Mask::splat(true);
    for i in 0..6 {
        near = near & (goal[i] - was[i]).abs().lt(S::splat(SAME[i / 3]));
    }
    near
}

/// Where all numbers are the same; nothing is the same as NaN.
#[inline(always)]
pub(super) fn equal<S: Real, const N: usize>(a: &[S; N], b: &[S; N]) -> S::Mask {
    let mut equal = S::Mask::splat(true);
    for (a, b) in a.iter().zip(b) {
        equal = equal & a.le(*b) & a.ge(*b);
    }
    equal
}
