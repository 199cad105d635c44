//! Looking for the joint angles that bring a hand to its goal.

use std::f64::consts::TAU;

use super::chain::{Angles, Chain, Frame, choose};
use crate::robot::MAX_JOINTS_PER_ARM;
use crate::scalar::{Kernel, Mask, Real};

/// Starts of a whole search beside where the arm stands and home.
pub(super) const STARTS: u64 = 14;
/// Steps of a whole search from each of its starts.
const STEPS: usize = 40;
/// Steps from a start that is tried later.
const LATER_STEPS: usize = 12;
/// Residual (m and rad, together) below which a lane has arrived: a search makes no more steps there.
const ARRIVED: f64 = 1e-5;
/// Residual (m and rad, together) below which angles bring the hand to its goal.
const SOLVED: f64 = 1e-3;
/// What is added to the cost of angles at which a joint is stopped (rad): more than any way of a joint.
pub(super) const STOPPED: f64 = 20.0;
/// What angles that do not bring the hand to its goal cost at least (rad): more than any that do, those of a stopped joint included.
pub(super) const UNSOLVED: f64 = 40.0;
/// Powers of 1/φ with φ⁷ = φ + 1: the recurrence of starts of arms of up to six joints.
const RECURRENCE_OF_SIX: [f64; 6] =
    [0.898_653_7, 0.807_578_5, 0.725_733_4, 0.652_183_0, 0.586_086_7, 0.526_689_0];
/// Powers of 1/φ with φ⁸ = φ + 1: the recurrence of starts of arms of seven joints.
const RECURRENCE_OF_SEVEN: [f64; MAX_JOINTS_PER_ARM] =
    [0.911_592_4, 0.831_000_6, 0.757_533_8, 0.690_562_0, 0.629_511_1, 0.573_857_5, 0.523_124_1];

/// An arm, where its hand shall go, and where its joints stand.
pub(super) struct Question<'a, S> {
    pub(super) chain: &'a Chain<S>,
    pub(super) target: &'a Frame<S>,
    pub(super) stands: &'a Angles<S>,
}

impl<S: Real> Question<'_, S> {
    /// What is to be said against going to `q`: the longest way of a joint (rad), [`STOPPED`], [`UNSOLVED`].
    #[inline(always)]
    pub(super) fn cost(&self, q: &Angles<S>) -> S {
        self.cost_of(q, self.miss(q))
    }

    /// By how much `q` misses the goal (m and rad, together).
    #[inline(always)]
    pub(super) fn miss(&self, q: &Angles<S>) -> S {
        self.chain.miss(self.target, q)
    }

    /// [`Question::cost`], where it is known by how much `q` misses the goal.
    #[inline(always)]
    pub(super) fn cost_of(&self, q: &Angles<S>, miss: S) -> S {
        let Self { chain, stands, .. } = self;
        let mut farthest = S::zero();
        for joint in 0..chain.n_joints() {
            farthest = farthest.max(chain.way(joint, stands[joint], q[joint]).abs());
        }
        let unsolved = S::splat(UNSOLVED) + miss;
        let cost = S::select(miss.lt(S::splat(SOLVED)), farthest, unsolved);
        S::select(chain.is_stopped(q), cost + S::splat(STOPPED), cost)
    }

    /// The best of many starts: where none brings the hand to its goal, what comes nearest to it.
    pub(super) fn search(self) -> Angles<S> {
        S::compiled(Search(self))
    }

    /// What start number `index` leads to.
    #[inline(always)]
    pub(super) fn later(&self, index: S) -> Angles<S> {
        let mut q = start(self.chain, index);
        for _ in 0..LATER_STEPS {
            q = self.chain.approach(self.target, &q).0;
        }
        q
    }
}

/// One way of an arm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Way<S> {
    pub(super) angles: Angles<S>,
    /// What is to be said against it, as [`Question::cost`] tells it.
    pub(super) cost: S,
}

impl<S: Real> Way<S> {
    /// Becomes the other one in these lanes.
    #[inline(always)]
    pub(super) fn take(&mut self, lanes: S::Mask, other: &Self) {
        choose(lanes, other.angles, &mut self.angles);
        self.cost = S::select(lanes, other.cost, self.cost);
    }
}

struct Search<'a, S>(Question<'a, S>);

impl<S: Real> Kernel<S> for Search<'_, S> {
    type Output = Angles<S>;
    #[inline(always)]
    fn run(self) -> Angles<S> {
        let Self(question) = self;
        let Question { chain, target, stands } = question;
        let mut best = *stands;
        let mut best_cost = S::splat(f64::INFINITY);
        for index in 0..STARTS + 2 {
            let mut q = match index {
                0 => *stands,
                1 => chain.home,
                _ => start(chain, S::splat((index - 1) as f64)),
            };
            for _ in 0..STEPS {
                let (next, left) = chain.approach(target, &q);
                // A lane that has arrived stays, so that its bits do not hang on how long others take.
                let arrived = left.lt(S::splat(ARRIVED));
                for (q, next) in q.iter_mut().zip(next) {
                    *q = S::select(arrived, *q, next);
                }
                if arrived.all() {
                    break;
                }
            }
            let cost = question.cost(&q);
            let better = cost.lt(best_cost);
            best_cost = S::select(better, cost, best_cost);
            for (best, q) in best.iter_mut().zip(q) {
                *best = S::select(better, q, *best);
            }
        }
        best
    }
}

/// Where a search begins: a point of the additive recurrence of Roberts (2018, "The unreasonable effectiveness of quasirandom sequences"), which
/// fills the half turns around home evenly.
#[inline(always)]
fn start<S: Real>(chain: &Chain<S>, index: S) -> Angles<S> {
    let mut q = chain.home;
    let shares = if chain.n_joints() > RECURRENCE_OF_SIX.len() {
        &RECURRENCE_OF_SEVEN[..]
    } else {
        &RECURRENCE_OF_SIX[..chain.n_joints()]
    };
    for (q, &share) in q.iter_mut().zip(shares) {
        let x = index * S::splat(share);
        let uniform = x - x.floor();
        *q += (uniform - S::splat(0.5)) * S::splat(TAU);
    }
    q
}
