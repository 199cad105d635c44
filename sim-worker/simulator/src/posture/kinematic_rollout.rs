//! A rollout of the kinematics alone: joints go as they are guided, and the base as no momentum lets it [Umetani and Yoshida 1989, eq. 9].
//!
//! A control step of it costs a hundredth of one of the dynamics.

use super::arm::{Following, Pace, Place, Posture};
use super::chain::Chain;
use super::follow::follow;
use super::search::{Question, STOPPED, Way};
use crate::collision::count_contacts;
use crate::dynamics::invariants::{BaseMotion, invariants};
use crate::model::Model;
use crate::robot::{Joints, MAX_ARMS};
use crate::scalar::{Mask as _, Real};
use crate::spatial::{
    Vec3, mat_vec, mul_add, quaternion_exp, quaternion_normalised, quaternion_product,
    quaternion_to_rotation, scale,
};
use crate::state::State;
use crate::workspace::Workspace;

/// Control steps that are looked ahead: half a turn at 0.8 rad/s takes ten.
pub(super) const STEPS: usize = 15;
/// What an arm that does not arrive counts, in longest ways (rad).
const MISSED: f64 = 100.0;
/// What a pair that touches counts in a control step (rad): an arm that touches for five of them is held up and does not arrive.
const TOUCHES: f64 = 20.0;

/// All active arms go to their postures, which follow the base on the way; the others stay where they are.
pub(super) struct KinematicRollout<S: Real> {
    workspace: Workspace<S>,
    joints: Joints,
    active: [bool; MAX_ARMS],
    following: Following,
    pub(super) arms: Vec<Posture<S>>,
    pub(super) state: State<S>,
    /// What its ways cost.
    ways: S,
    /// All pairs that touched, control step by control step.
    touched: S,
}

impl<S: Real> KinematicRollout<S> {
    /// It has not begun.
    #[inline(always)]
    pub(super) fn new(
        model: &Model<S>,
        arms: &[Chain<S>],
        (active, following): ([bool; MAX_ARMS], Following),
    ) -> Self {
        let zeros = vec![S::zero(); model.n_joints()];
        let at_zero = [S::zero(); 3];
        Self {
            workspace: Workspace::new(model),
            joints: model.joints,
            active,
            following,
            arms: arms.iter().cloned().map(Posture::new).collect(),
            state: State {
                base_position: at_zero,
                base_quaternion: [S::one(), S::zero(), S::zero(), S::zero()],
                base_linear_velocity: at_zero,
                base_angular_velocity: at_zero,
                q: zeros.clone(),
                qd: zeros,
            },
            ways: S::zero(),
            touched: S::zero(),
        }
    }

    /// Begins anew: from `place`, with arms that go these ways.
    #[inline(always)]
    pub(super) fn begin(&mut self, arms: &[Posture<S>], ways: &[Way<S>], place: &Place<'_, S>) {
        self.ways = S::zero();
        for (index, (arm, way)) in self.arms.iter_mut().zip(ways).enumerate() {
            arm.restart_from(&arms[index], &way.angles);
            if self.active[index] {
                self.ways += S::select(way.cost.lt(S::splat(STOPPED)), way.cost, S::zero());
            }
        }
        self.touched = S::zero();
        self.state.base_position = place.position;
        self.state.base_quaternion = place.quaternion;
        self.state.q.copy_from_slice(place.q);
    }

    /// What its ways and all that touched cost (rad).
    #[inline(always)]
    pub(super) fn cost(&self) -> S {
        self.ways + self.touched * S::splat(TOUCHES)
    }

    /// [`cost`](Self::cost), and that of arms that have not arrived: `farther` for each metre and radian that they miss their goals by, and a lot beside.
    #[inline(always)]
    pub(super) fn final_cost(&self, goals: &[[S; 6]], farther: S) -> S {
        let mut cost = self.cost();
        let now = self.place();
        for (index, arm) in self.arms.iter().enumerate() {
            let misses = arm.good.lt(S::one());
            if !self.active[index] || !misses.any() {
                continue;
            }
            let (target, stands) = (now.seen(&goals[index]), now.stands(index));
            let question = Question { chain: &arm.chain, target: &target, stands: &stands };
            let missed = S::splat(MISSED) + farther * question.miss(&arm.angles);
            cost += S::select(misses, missed, S::zero());
        }
        cost
    }

    /// Where the robot is.
    #[inline(always)]
    fn place(&self) -> Place<'_, S> {
        let State { base_position: position, base_quaternion: quaternion, q, .. } = &self.state;
        Place { position: *position, quaternion: *quaternion, q, joints: self.joints }
    }

    /// Has postures follow the base in these lanes.
    #[inline(always)]
    pub(super) fn follow(&mut self, goals: &[[S; 6]], lanes: S::Mask) {
        let State { base_position: position, base_quaternion: quaternion, q, .. } = &self.state;
        let now = Place { position: *position, quaternion: *quaternion, q, joints: self.joints };
        follow(&mut self.arms, goals, &now, &[!lanes; MAX_ARMS], self.following);
    }

    /// Goes on for a control step, by the midpoint rule.
    #[inline(always)]
    pub(super) fn advance(&mut self, model: &Model<S>, pace: &Pace<S>) {
        let Self { workspace, joints, active, arms, state, touched, .. } = self;
        for (index, arm) in arms.iter().enumerate() {
            let joints = joints.of_arm(index);
            let factor = pace.gain / pace.period;
            if active[index] {
                arm.rates(factor, &pace.limits[joints.clone()], &mut state.qd[joints]);
            } else {
                state.qd[joints].fill(S::zero());
            }
        }
        let period = S::splat(pace.period);
        let half = S::splat(0.5);
        let zero = [S::zero(); 3];
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
        *touched += count_contacts(model, workspace, state);
    }
}

/// An attitude after a time (s) at an angular velocity (rad/s, its own axes).
#[inline(always)]
fn turned<S: Real>(quaternion: &[S; 4], time: S, rates: Vec3<S>) -> [S; 4] {
    let by = quaternion_exp(scale(time, rates));
    quaternion_normalised(&quaternion_product(quaternion, &by))
}
