//! Which ways the arms take together, by where the base will be when all hands have gone to their goals.
//!
//! Arms that move push the base, and a base that has moved by centimetres brings goals into the reach of an arm or takes them out of it. So ways are
//! judged together, a set with one way of each arm at a time, by a [rollout of the kinematics](KinematicRollout). An arm that has no way to its goal
//! may go elsewhere, where that brings others to theirs.
//!
//! **A lane is a set.** The environments of a lane group choose one after another, each in all lanes, or in all lanes of a register. Sets are tried in rounds of [`LANES`]: all
//! of a round vary what was best before it. So the choice does not hang on how many lanes there are.

use super::arm::{Following, Pace, Place, Posture};
use super::chain::{Angles, Chain, Frame, everywhere};
use super::kinematic_rollout::{self, KinematicRollout};
use super::search::{Question, STARTS, STOPPED, UNSOLVED, Way};
use crate::model::Model;
use crate::robot::{MAX_ARMS, Robot};
use crate::scalar::{Kernel, LANES, Mask, Real};

/// Rounds of sets that are tried.
const ROUNDS: usize = 5;
/// Sets of ways that are tried. In the first one, number 0, every arm takes the way that it has.
const SETS: usize = ROUNDS * LANES;

/// What it counts for each metre and radian that an arm misses its goal by, where hands are persistent (rad): of two sets the one that comes nearer is
/// better, but hardly an arm leaves its goal for that.
const FARTHER: f64 = 0.1;

/// The robot in all lanes in which sets are tried.
#[derive(Debug, Clone)]
pub(super) struct Trials<T: Real> {
    model: Model<T>,
    chains: Vec<Chain<T>>,
    pace: Pace<T>,
}

impl<T: Real> Trials<T> {
    /// Arms go at `pace`, the same in all lanes.
    pub(super) fn new<S: Real>(robot: &Robot, pace: &Pace<S>) -> Self {
        let Pace { gain, period, limits } = pace;
        let limits = limits.iter().map(|&limit| everywhere(limit, 0)).collect();
        let pace = Pace { gain: *gain, period: *period, limits };
        Self { model: Model::new(robot), chains: Chain::of(robot), pace }
    }
}

/// The postures of a lane group that are yet to be chosen, in the lanes of `open`, an entry an arm.
pub(super) struct Foresight<'a, S: Real> {
    pub(super) goals: &'a [[S; 6]],
    pub(super) place: &'a Place<'a, S>,
    pub(super) open: &'a [S::Mask],
    /// Which arms go to their postures; sets say nothing of the others.
    pub(super) active: [bool; MAX_ARMS],
    pub(super) following: Following,
    /// Whether arms without a way come as near to their goals as they can.
    pub(super) persistent: bool,
    /// How often they were chosen for these goals already: other ways are looked for each time.
    pub(super) before: S,
    /// Whether every set is tried to its end, also when it cannot become the best any more: the twin that tests giving up.
    pub(super) to_the_end: bool,
}

impl<S: Real> Foresight<'_, S> {
    /// Gives every arm the way with which most of them arrive, and of such ways the shortest, or where hands are persistent one with which the others come nearer.
    pub(super) fn choose<T: Real>(self, arms: &mut [Posture<S>], trials: &Trials<T>) {
        S::compiled(Choose { foresight: self, arms, trials });
    }
}

struct Choose<'a, 'b, S: Real, T: Real> {
    foresight: Foresight<'a, S>,
    arms: &'b mut [Posture<S>],
    trials: &'b Trials<T>,
}

impl<S: Real, T: Real> Kernel<S> for Choose<'_, '_, S, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Self { foresight, arms, trials: Trials { model, chains, pace } } = self;
        let Foresight { goals, place, open, active, following, .. } = foresight;
        let Foresight { persistent, before, to_the_end, .. } = foresight;
        let mut rollout = KinematicRollout::<T>::new(model, chains, (active, following));
        let farther = T::splat(if persistent { FARTHER } else { 0.0 });
        for lane in 0..S::LANES {
            let mut is_open = [false; MAX_ARMS];
            for (is_open, open) in is_open.iter_mut().zip(open) {
                *is_open = open.lane(lane);
            }
            if is_open == [false; MAX_ARMS] {
                continue;
            }
            let q: Vec<T> = place.q.iter().map(|q| everywhere(*q, lane)).collect();
            let place = Place {
                position: place.position.map(|x| everywhere(x, lane)),
                quaternion: place.quaternion.map(|x| everywhere(x, lane)),
                q: &q,
                joints: place.joints,
            };
            let goals: Vec<_> =
                goals.iter().map(|goal| goal.map(|x| everywhere(x, lane))).collect();
            let alone: Vec<_> =
                arms.iter().zip(chains).map(|(arm, chain)| arm.everywhere(lane, chain)).collect();
            let first_start =
                everywhere::<S, T>(before, lane) * T::splat((SETS * arms.len()) as f64);
            let mut sets = Sets::new(&alone, &goals, &place, first_start);
            for number in (0..SETS).step_by(T::LANES) {
                if number % LANES == 0 {
                    sets.begin_round();
                }
                sets.vary(number, &alone, &is_open);
                rollout.begin(&alone, &sets.tried, &place);
                // Costs only grow: a set that costs no less than the best is given up.
                let best = if to_the_end { f64::INFINITY } else { sets.next_cost };
                let limit = T::splat(best);
                let mut hopeful = rollout.cost().lt(limit);
                for _ in 0..kinematic_rollout::STEPS {
                    if !hopeful.any() {
                        break;
                    }
                    rollout.follow(&goals, hopeful);
                    rollout.advance(model, pace);
                    hopeful = hopeful & rollout.cost().lt(limit);
                }
                if hopeful.any() {
                    rollout.follow(&goals, hopeful);
                    sets.judge(hopeful, rollout.final_cost(&goals, farther));
                }
            }
            for ((arm, best), is_open) in arms.iter_mut().zip(&sets.next).zip(is_open) {
                if is_open {
                    for (angle, best) in arm.angles.iter_mut().zip(best.angles) {
                        angle.set_lane(lane, best.lane(0));
                    }
                }
            }
        }
    }
}

/// The sets that one environment tries, a lane each, and the best of them so far. Ways have an entry an arm.
struct Sets<S> {
    targets: Vec<Frame<S>>,
    stands: Vec<Angles<S>>,
    /// The first start of a search for a way.
    first_start: S,
    tried: Vec<Way<S>>,
    /// What was best before this round, in all lanes.
    best: Vec<Way<S>>,
    /// What is best now, in all lanes.
    next: Vec<Way<S>>,
    next_cost: f64,
}

impl<S: Real> Sets<S> {
    #[inline(always)]
    fn new(arms: &[Posture<S>], goals: &[[S; 6]], place: &Place<'_, S>, first_start: S) -> Self {
        let targets: Vec<_> = goals.iter().map(|goal| place.seen(goal)).collect();
        let stands: Vec<_> = (0..arms.len()).map(|arm| place.stands(arm)).collect();
        let mut ways = Vec::with_capacity(arms.len());
        for (index, arm) in arms.iter().enumerate() {
            let (target, stands) = (&targets[index], &stands[index]);
            let question = Question { chain: &arm.chain, target, stands };
            ways.push(Way { angles: arm.angles, cost: question.cost(&arm.angles) });
        }
        Self {
            targets,
            stands,
            first_start,
            tried: ways.clone(),
            best: ways.clone(),
            next: ways,
            next_cost: f64::INFINITY,
        }
    }

    /// From here on sets vary what is best now.
    #[inline(always)]
    fn begin_round(&mut self) {
        self.best.copy_from_slice(&self.next);
    }

    /// Goes to the sets from `first` on.
    #[inline(always)]
    fn vary(&mut self, first: usize, arms: &[Posture<S>], is_open: &[bool]) {
        let n_arms = arms.len();
        for (index, arm) in arms.iter().enumerate() {
            let tried = &mut self.tried[index];
            *tried = self.best[index];
            let mut varied = S::Mask::splat(false);
            let mut start = S::zero();
            for lane in 0..S::LANES {
                let set = first + lane;
                varied.set_lane(lane, is_open[index] && is_varied(set, index, n_arms));
                start.set_lane(lane, (STARTS as usize + 1 + set * n_arms + index) as f64);
            }
            if !varied.any() {
                continue;
            }
            let (target, stands) = (&self.targets[index], &self.stands[index]);
            let question = Question { chain: &arm.chain, target, stands };
            let angles = question.later(self.first_start + start);
            let other = Way { angles, cost: question.cost(&angles) };
            // Where no way is known, it may go elsewhere, but not to a stop.
            let unsolved = S::splat(UNSOLVED);
            let elsewhere = tried.cost.ge(unsolved) & other.cost.lt(unsolved + S::splat(STOPPED));
            let is_way = other.cost.lt(S::splat(STOPPED));
            tried.take(varied & (is_way | elsewhere), &other);
        }
    }

    /// Takes over the cheapest of the sets of these lanes where it costs less than the best; of two alike the first.
    #[inline(always)]
    fn judge(&mut self, lanes: S::Mask, cost: S) {
        for lane in 0..S::LANES {
            if !lanes.lane(lane) || cost.lane(lane) >= self.next_cost {
                continue;
            }
            self.next_cost = cost.lane(lane);
            for (next, tried) in self.next.iter_mut().zip(&self.tried) {
                let angles = tried.angles.map(|angle| everywhere(angle, lane));
                *next = Way { angles, cost: everywhere(tried.cost, lane) };
            }
        }
    }
}

/// Whether arm `index` takes another way in a set than in the best one before its round: all do in the first round and in every second set, one or two in the others.
fn is_varied(set: usize, index: usize, n_arms: usize) -> bool {
    let turn = set / 2;
    let (one, two) = (turn % n_arms, (turn / n_arms) % n_arms);
    set > 0 && (set < LANES || set.is_multiple_of(2) || index == one || index == two)
}
