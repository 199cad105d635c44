//! What a step is worth.
//!
//! One formula serves all agents, with the weights of [`RewardWeights`]:
//!
//! r = −(quadratic·e² + log·log₁₀(e² + ε) + smoothness·‖u − u⁻‖² + effort·‖u‖² + collision·co)
//!
//! e is `scale` times the error norm after the step, u the clipped action before scaling, u⁻ the
//! step before's, co the number of touching pairs of the whole robot after the step (or of those in
//! which the agent's arm takes part), or whether any touch. Of an arm that reaches, position and orientation agents each have their own e and weights and the
//! norms run over the agent's joints. For all agents of arms that turn the base e and the norms, which run over the joints of these
//! arms, are the same.
//!
//! The two agents of an arm that reaches may share: each then gets (1 − τ) times its own reward and
//! τ times the mean of both, the team spirit of OpenAI et al. 2019 ("Dota 2 with large scale deep
//! reinforcement learning", appendix G). Shoulder and wrist reach one pose together, and a shoulder that
//! cares for position alone leaves the wrist where it cannot turn without touching the arm.

use proto::config::{Reward, RewardWeights};
use proto::layout::AGENTS_PER_ARM;

use super::{Aim, Errors, Task};
use crate::collision::Touching;
use crate::scalar::{Kernel, Real};

/// The formula; `error` is the plain norm, `change` and `effort` squared norms.
#[inline(always)]
fn formula<S: Real>(
    weights: &RewardWeights,
    epsilon: f64,
    error: S,
    change: S,
    effort: S,
    collision: S,
) -> S {
    let e = error * S::splat(weights.scale);
    let square = e * e;
    let cost = square * S::splat(weights.quadratic);
    let cost = (square + S::splat(epsilon)).log10().mul_add(S::splat(weights.log), cost);
    let cost = change.mul_add(S::splat(weights.smoothness), cost);
    let cost = effort.mul_add(S::splat(weights.effort), cost);
    -collision.mul_add(S::splat(weights.collision), cost)
}

/// Writes the reward of every agent into `out` (length A).
///
/// `action` and `last_action` are the clipped actions of this step and of the one before, one a
/// joint; `touching` is what touches after the step.
#[inline(always)]
pub fn rewards<S: Real>(
    task: &Task,
    errors: &Errors<S>,
    action: &[S],
    last_action: &[S],
    touching: &Touching<S>,
    out: &mut [S],
) {
    S::compiled(Rewards { task, errors, action, last_action, touching, out });
}

struct Rewards<'a, S: Real> {
    task: &'a Task,
    errors: &'a Errors<S>,
    action: &'a [S],
    last_action: &'a [S],
    touching: &'a Touching<S>,
    out: &'a mut [S],
}

impl<S: Real> Kernel<S> for Rewards<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { task, errors, action, last_action, touching, out } = self;
        let motion = motion_of_turning_arms(task, action, last_action);
        for (arm, out) in out.chunks_exact_mut(AGENTS_PER_ARM).enumerate() {
            match task.aims[arm] {
                Aim::Hand => of_hand((task, arm), errors, action, last_action, touching, out),
                Aim::Base => out.fill(of_base((task, arm), errors, motion, touching)),
            }
        }
    }
}

/// Rewards of the agents of an arm that reaches.
#[inline(always)]
fn of_hand<S: Real>(
    (task, arm): (&Task, usize),
    errors: &Errors<S>,
    action: &[S],
    last_action: &[S],
    touching: &Touching<S>,
    out: &mut [S],
) {
    let reward = &task.reward;
    let cares = [
        (&reward.position, errors.position_norm[arm]),
        (&reward.orientation, errors.orientation_norm[arm]),
    ];
    for (index, ((weights, error), out)) in cares.into_iter().zip(&mut *out).enumerate() {
        let agent = arm * AGENTS_PER_ARM + index;
        let joints = task.joints.of_agent(agent);
        let mut motion = (S::zero(), S::zero());
        add_squared_norms(&action[joints.clone()], &last_action[joints], &mut motion);
        let (change, effort) = motion;
        let pairs = if reward.own_collisions { touching.by_arm[arm] } else { touching.pairs };
        let collision = collision(reward, pairs);
        *out = formula(weights, reward.epsilon, error, change, effort, collision);
    }
    if reward.team_spirit > 0.0 {
        let share = S::splat(0.5 * reward.team_spirit);
        // (1 − τ) r + τ (r + r′) / 2 = r + τ/2 (r′ − r)
        let moved = (out[1] - out[0]) * share;
        out[0] += moved;
        out[1] -= moved;
    }
}

/// ‖u − u⁻‖² and ‖u‖² over the joints of all arms that turn the base.
#[inline(always)]
fn motion_of_turning_arms<S: Real>(task: &Task, action: &[S], last_action: &[S]) -> (S, S) {
    let mut motion = (S::zero(), S::zero());
    for (arm, aim) in task.aims.iter().enumerate() {
        if *aim == Aim::Base {
            let joints = task.joints.of_arm(arm);
            add_squared_norms(&action[joints.clone()], &last_action[joints], &mut motion);
        }
    }
    motion
}

/// The reward of the agents of an arm that turns the base, all of which move by `motion`.
#[inline(always)]
fn of_base<S: Real>(
    (task, arm): (&Task, usize),
    errors: &Errors<S>,
    (change, effort): (S, S),
    touching: &Touching<S>,
) -> S {
    let reward = &task.reward;
    let pairs = if reward.own_collisions { touching.by_arm[arm] } else { touching.pairs };
    let collision = collision(reward, pairs);
    formula(&reward.base, reward.epsilon, errors.base_norm, change, effort, collision)
}

/// What `pairs` that touch count: each of them, or one for all.
#[inline(always)]
fn collision<S: Real>(reward: &Reward, pairs: S) -> S {
    if reward.count_collisions {
        return pairs;
    }
    S::select(pairs.gt(S::zero()), S::one(), S::zero())
}

/// Adds ‖u − u⁻‖² and ‖u‖².
#[inline(always)]
fn add_squared_norms<S: Real>(action: &[S], last_action: &[S], (change, effort): &mut (S, S)) {
    for (&u, &last) in action.iter().zip(last_action) {
        let d = u - last;
        *change = d.mul_add(d, *change);
        *effort = u.mul_add(u, *effort);
    }
}
