//! Which ways the arms take together, by where the base will be when all hands have gone to their goals.
//!
//! Arms that move push the base, and a base that has moved by centimetres brings goals into the reach of an arm or takes them out of it. So ways are
//! judged together, a set with one way of each arm at a time, by a [rollout of the kinematics](KinematicRollout).
//!
//! **Each lane at its own pace.** Most sets are given up after a few control steps. A lane that gives one up begins its next one at once, while others
//! go on with theirs.

use super::arm::{Pace, Place, Posture};
use super::chain::{choose, put_lane};
use super::kinematic_rollout::KinematicRollout;
use super::search::{Question, STARTS, STOPPED, Way};
use crate::model::Model;
use crate::scalar::{Kernel, LANES, Mask, Real};

/// Sets of ways that are judged. In the first one, number 0, every arm takes its nearest way.
const SETS: u64 = 40;
/// Sets below this number, but the first, have another way of every arm. Those from it on are the best set so far with another way of one or two arms.
const SPREAD: u64 = 8;

/// The postures of a lane group that are yet to be chosen, in the lanes of `open`, an entry an arm.
pub(super) struct Foresight<'a, S: Real> {
    pub(super) model: &'a Model<S>,
    pub(super) pace: &'a Pace<S>,
    pub(super) goals: &'a [[S; 6]],
    pub(super) place: &'a Place<'a, S>,
    pub(super) open: &'a [S::Mask],
    /// Whether every set is tried to its end, also when it cannot become the best any more: the twin that tests giving up.
    pub(super) to_the_end: bool,
}

impl<S: Real> Foresight<'_, S> {
    /// Gives every arm the way with which most of them arrive, and of such ways the shortest.
    pub(super) fn choose(self, arms: &mut [Posture<S>]) {
        S::compiled(Choose { foresight: self, arms });
    }
}

struct Choose<'a, 'b, S: Real> {
    foresight: Foresight<'a, S>,
    arms: &'b mut [Posture<S>],
}

impl<S: Real> Kernel<S> for Choose<'_, '_, S> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Self { foresight, arms } = self;
        let Foresight { model, pace, goals, place, open, to_the_end } = foresight;
        let mut sets = Sets::new(arms, goals, place, open);
        let mut rollout = KinematicRollout::new(model, arms, place);
        let mut active = S::Mask::splat(false);
        for open in open {
            active = active | *open;
        }
        let mut beginning = active;
        loop {
            // Costs only grow: a set that costs no less than the best is given up.
            let limit = if to_the_end { S::splat(f64::INFINITY) } else { sets.best_cost };
            // A set's ways alone may cost too much.
            while beginning.any() {
                let past_the_last = sets.next(beginning, open);
                active = active & !past_the_last;
                beginning = beginning & !past_the_last;
                rollout.begin(beginning, arms, &sets.tried, place);
                beginning = beginning & !rollout.cost().lt(limit);
            }
            if !active.any() {
                break;
            }
            rollout.follow(goals, active);
            let ended = active & rollout.has_ended();
            sets.judge(ended, rollout.final_cost());
            rollout.advance(model, pace);
            beginning = ended | (active & !rollout.cost().lt(limit));
        }
        for ((arm, best), open) in arms.iter_mut().zip(&sets.best).zip(open) {
            choose(*open, best.angles, &mut arm.angles);
        }
    }
}

/// The sets that lanes try, and the best of them so far.
struct Sets<S> {
    /// `[set, arm]`: what an arm takes instead of the best way so far.
    others: Vec<Option<Way<S>>>,
    /// Which set each lane tries next.
    numbers: [u64; LANES],
    /// An entry an arm.
    tried: Vec<Way<S>>,
    best: Vec<Way<S>>,
    best_cost: S,
}

impl<S: Real> Sets<S> {
    #[inline(always)]
    fn new(arms: &[Posture<S>], goals: &[[S; 6]], place: &Place<'_, S>, open: &[S::Mask]) -> Self {
        let n_arms = arms.len();
        let mut nearest = Vec::with_capacity(n_arms);
        let mut others = vec![None; SETS as usize * n_arms];
        for (index, arm) in arms.iter().enumerate() {
            let (target, stands) = (place.seen(&goals[index]), place.stands(index));
            let question = Question { chain: &arm.chain, target: &target, stands: &stands };
            nearest.push(Way { angles: arm.angles, cost: question.cost(&arm.angles) });
            if !open[index].any() {
                continue;
            }
            for set in 1..SETS {
                if is_varied(set, index as u64, n_arms as u64) {
                    let at = set as usize * n_arms + index;
                    let angles = question.later(S::splat((STARTS as usize + 1 + at) as f64));
                    others[at] = Some(Way { angles, cost: question.cost(&angles) });
                }
            }
        }
        Self {
            others,
            numbers: [0; LANES],
            tried: nearest.clone(),
            best: nearest,
            best_cost: S::splat(f64::INFINITY),
        }
    }

    /// Goes to the next set in these lanes; says where there is none.
    #[inline(always)]
    fn next(&mut self, lanes: S::Mask, open: &[S::Mask]) -> S::Mask {
        let Self { others, numbers, tried, best, .. } = self;
        for (tried, best) in tried.iter_mut().zip(best) {
            tried.take(lanes, best);
        }
        let mut past_the_last = S::Mask::splat(false);
        for lane in 0..S::LANES {
            if !lanes.lane(lane) {
                continue;
            }
            if numbers[lane] == SETS {
                past_the_last.set_lane(lane, true);
                continue;
            }
            let first = numbers[lane] as usize * tried.len();
            numbers[lane] += 1;
            for (index, tried) in tried.iter_mut().enumerate() {
                if let Some(other) = &others[first + index]
                    && open[index].lane(lane)
                    && other.cost.lane(lane) < STOPPED
                {
                    put_lane(&mut tried.angles, lane, &other.angles, lane);
                    tried.cost.set_lane(lane, other.cost.lane(lane));
                }
            }
        }
        past_the_last
    }

    /// Takes over what these lanes tried where it cost less than the best.
    #[inline(always)]
    fn judge(&mut self, lanes: S::Mask, cost: S) {
        let better = lanes & cost.lt(self.best_cost);
        self.best_cost = S::select(better, cost, self.best_cost);
        for (best, tried) in self.best.iter_mut().zip(&self.tried) {
            best.take(better, tried);
        }
    }
}

/// Whether arm `index` takes another way in a set than in the best one so far.
fn is_varied(set: u64, index: u64, n_arms: u64) -> bool {
    let second = (set / n_arms) % n_arms;
    set < SPREAD || index == set % n_arms || index == second
}
