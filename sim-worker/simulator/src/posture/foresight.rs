//! Where the base will be when all hands have gone to their goals.
//!
//! Arms that move push the base, and a base that has moved by centimetres brings goals into the reach of an arm or takes them out of it. So ways are
//! judged together: a rollout of the kinematics alone, in which joints go as they are guided and the base goes as no momentum
//! lets it [Umetani and Yoshida 1989, eq. 9], tells where all arms end. A control step of it costs a hundredth of one of the dynamics.

use super::arm::{Pace, Place, Posture, choose};
use super::chain::Angles;
use super::search::{Question, STARTS, STOPPED};
use crate::collision::count_contacts;
use crate::dynamics::invariants::{BaseMotion, invariants};
use crate::model::Model;
use crate::robot::Robot;
use crate::scalar::{Kernel, Mask, Real};
use crate::spatial::{
    Vec3, mat_vec, mul_add, quaternion_exp, quaternion_normalised, quaternion_product,
    quaternion_to_rotation, scale,
};
use crate::state::State;
use crate::workspace::Workspace;

/// Sets of ways that are judged: the nearest of each arm,
const SETS: u64 = 40;
/// so many in which every arm takes another one, and then the best so far with another way of one or two arms.
const SPREAD: u64 = 8;
/// Control steps that are looked ahead: half a turn at 0.8 rad/s takes ten.
const STEPS: usize = 15;
/// What an arm that does not arrive counts, in longest ways (rad).
const MISSED: f64 = 100.0;
/// What a pair that touches counts in a control step (rad): an arm that touches for five of them is held up and does not arrive.
const TOUCHES: f64 = 20.0;

/// The postures of a lane group that are yet to be chosen, in the lanes of `open`, an entry an arm.
pub(super) struct Foresight<'a, S: Real> {
    pub(super) robot: &'a Robot,
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
        let Foresight { robot, pace, goals, place, open, to_the_end } = foresight;
        let model = Model::<S>::new(robot);
        let mut workspace = Workspace::new(&model);
        let mut best: Vec<Angles<S>> = arms.iter().map(|arm| arm.angles).collect();
        let mut best_cost = S::splat(f64::INFINITY);
        let n_arms = arms.len() as u64;
        let any_open = open.iter().fold(S::Mask::splat(false), |any, open| any | *open);
        for set in 0..SETS {
            let mut tried = arms.to_vec();
            let mut cost = S::zero();
            for (index, arm) in tried.iter_mut().enumerate() {
                let target = place.seen(&goals[index]);
                let stands = place.stands(index);
                let question = Question { chain: &arm.chain, target: &target, stands: &stands };
                arm.angles = best[index];
                let mut of_way = question.cost(&arm.angles);
                if set > 0 && is_varied(set, index as u64, n_arms) {
                    let number = STARTS + 1 + set * n_arms + index as u64;
                    let other = question.later(S::splat(number as f64));
                    let other_cost = question.cost(&other);
                    let taken = open[index] & other_cost.lt(S::splat(STOPPED));
                    choose(taken, other, &mut arm.angles);
                    of_way = S::select(taken, other_cost, of_way);
                }
                cost += S::select(of_way.lt(S::splat(STOPPED)), of_way, S::zero());
            }
            let first: Vec<Angles<S>> = tried.iter().map(|arm| arm.angles).collect();
            let limit = if to_the_end { S::splat(f64::INFINITY) } else { best_cost };
            let costs = Costs { ways: cost, limit, any_open };
            let cost = play((&model, &mut workspace), pace, goals, place, costs, &mut tried);
            let better = cost.lt(best_cost);
            best_cost = S::select(better, cost, best_cost);
            for (best, first) in best.iter_mut().zip(first) {
                choose(better, first, best);
            }
        }
        for ((arm, best), open) in arms.iter_mut().zip(best).zip(open) {
            choose(*open, best, &mut arm.angles);
        }
    }
}

/// Whether arm `index` takes another way in a set than in the best one so far.
fn is_varied(set: u64, index: u64, n_arms: u64) -> bool {
    let second = (set / n_arms) % n_arms;
    set < SPREAD || index == set % n_arms || index == second
}

/// What is known of the costs of a set of ways before it is tried.
#[derive(Clone, Copy)]
struct Costs<S: Real> {
    /// What its ways cost.
    ways: S,
    /// What the best set so far costs; a set that reaches it is given up.
    limit: S,
    /// Lanes for which sets are tried.
    any_open: S::Mask,
}

/// Has all arms go to their postures, which follow the base on the way; what that costs, with all pairs that touch on it, control step by control step,
/// and all arms that do not arrive.
///
/// Costs only grow. A lane in which they are no longer below the best takes no part from then on, and its cost may come out lower than it is, but
/// not below the best.
#[inline(always)]
fn play<S: Real>(
    (model, workspace): (&Model<S>, &mut Workspace<S>),
    pace: &Pace<S>,
    goals: &[[S; 6]],
    place: &Place<'_, S>,
    costs: Costs<S>,
    arms: &mut [Posture<S>],
) -> S {
    let period = S::splat(pace.period);
    let half = S::splat(0.5);
    let zero = [S::zero(); 3];
    let rates = vec![S::zero(); place.q.len()];
    let mut state = State {
        base_position: place.position,
        base_quaternion: place.quaternion,
        base_linear_velocity: zero,
        base_angular_velocity: zero,
        q: place.q.to_vec(),
        qd: rates,
    };
    let mut touched = S::zero();
    let mut cost = costs.ways;
    for step in 0..=STEPS {
        cost = costs.ways + touched * S::splat(TOUCHES);
        let undecided = costs.any_open & cost.lt(costs.limit);
        if !undecided.any() {
            return cost;
        }
        let (position, quaternion) = (state.base_position, state.base_quaternion);
        let now = Place { position, quaternion, q: &state.q, joints: place.joints };
        for (index, arm) in arms.iter_mut().enumerate() {
            arm.follow(&goals[index], (&now, !undecided), index);
            let joints = place.joints.of_arm(index);
            let factor = pace.gain / pace.period;
            arm.rates(factor, &pace.limits[joints.clone()], &mut state.qd[joints]);
        }
        if step == STEPS {
            break;
        }
        // Midpoint rule.
        for (q, rate) in state.q.iter_mut().zip(&state.qd) {
            *q = (half * period).mul_add(*rate, *q);
        }
        let quaternion = state.base_quaternion;
        let at_rest = BaseMotion { position: zero, quaternion, linear: zero, angular: zero };
        let v = invariants(model, workspace, &at_rest, &state.q, &state.qd).recoil();
        for (q, rate) in state.q.iter_mut().zip(&state.qd) {
            *q = (half * period).mul_add(*rate, *q);
        }
        let middle = quaternion_to_rotation(&turned(&quaternion, half * period, v.ang));
        state.base_position = mul_add(period, mat_vec(&middle, v.lin), state.base_position);
        state.base_quaternion = turned(&quaternion, period, v.ang);
        touched += count_contacts(model, workspace, &state);
    }
    for arm in arms {
        cost += (S::one() - arm.good) * S::splat(MISSED);
    }
    cost
}

/// An attitude after a time (s) at an angular velocity (rad/s, its own axes).
#[inline(always)]
fn turned<S: Real>(quaternion: &[S; 4], time: S, rates: Vec3<S>) -> [S; 4] {
    let by = quaternion_exp(scale(time, rates));
    quaternion_normalised(&quaternion_product(quaternion, &by))
}
