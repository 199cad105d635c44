//! What a step is worth.
//!
//! One formula serves all agents, with the weights of [`RewardWeights`]:
//!
//! r = −(quadratic·e² + log·log₁₀(e² + ε) + smoothness·‖u − u⁻‖² + effort·‖u‖² + collision·co)
//!
//! e is `scale` times the error norm after the step, u the clipped action before scaling, u⁻ the
//! step before's, co the number of touching pairs of the whole robot after the step (or of those in
//! which the agent's arm takes part), or whether any touch. In `trajectory`, position and orientation agents each have their own e and weights and the
//! norms run over the agent's three joints. In `reorientation` every agent receives the same number
//! and the norms run over all joints.
//!
//! In `trajectory` the two agents of an arm may share: each then gets (1 − τ) times its own reward and
//! τ times the mean of both, the team spirit of OpenAI et al. 2019 ("Dota 2 with large scale deep
//! reinforcement learning", appendix G). Shoulder and wrist reach one pose together, and a shoulder that
//! cares for position alone leaves the wrist where it cannot turn without touching the arm.

use proto::config::{Reward, RewardWeights, TaskName};
use proto::layout::{AGENTS_PER_ARM, JOINTS_PER_AGENT};

use super::{Errors, Task};
use crate::collision::Touching;
use crate::scalar::Real;

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
    let reward = &task.reward;
    match task.name {
        TaskName::Trajectory => {
            for (agent, out) in out.iter_mut().enumerate() {
                let arm = agent / AGENTS_PER_ARM;
                let joints = agent * JOINTS_PER_AGENT..(agent + 1) * JOINTS_PER_AGENT;
                let (weights, error) = if agent.is_multiple_of(AGENTS_PER_ARM) {
                    (&reward.position, errors.position_norm[arm])
                } else {
                    (&reward.orientation, errors.orientation_norm[arm])
                };
                let (change, effort) = squared_norms(&action[joints.clone()], &last_action[joints]);
                let pairs =
                    if reward.own_collisions { touching.by_arm[arm] } else { touching.pairs };
                *out = formula(
                    weights,
                    reward.epsilon,
                    error,
                    change,
                    effort,
                    collision(reward, pairs),
                );
            }
            if reward.team_spirit > 0.0 {
                let share = S::splat(0.5 * reward.team_spirit);
                for of_arm in out.chunks_exact_mut(AGENTS_PER_ARM) {
                    // (1 − τ) r + τ (r + r′) / 2 = r + τ/2 (r′ − r)
                    let moved = (of_arm[1] - of_arm[0]) * share;
                    of_arm[0] += moved;
                    of_arm[1] -= moved;
                }
            }
        }
        TaskName::Reorientation => {
            let (change, effort) = squared_norms(action, last_action);
            let collision = collision(reward, touching.pairs);
            let shared =
                formula(&reward.base, reward.epsilon, errors.base_norm, change, effort, collision);
            out.fill(shared);
        }
    }
}

/// What `pairs` that touch count: each of them, or one for all.
#[inline(always)]
fn collision<S: Real>(reward: &Reward, pairs: S) -> S {
    if reward.count_collisions {
        return pairs;
    }
    S::select(pairs.gt(S::zero()), S::one(), S::zero())
}

/// ‖u − u⁻‖² and ‖u‖².
#[inline(always)]
fn squared_norms<S: Real>(action: &[S], last_action: &[S]) -> (S, S) {
    let (mut change, mut effort) = (S::zero(), S::zero());
    for (&u, &last) in action.iter().zip(last_action) {
        let d = u - last;
        change = d.mul_add(d, change);
        effort = u.mul_add(u, effort);
    }
    (change, effort)
}
