//! Refusing what has diverged: actions that are no numbers, states beyond all bounds.

use super::EpisodeError;
use crate::robot::Joints;
use crate::scalar::{Mask, Real};
use crate::state::State;

/// Refuses means that are no numbers; `env` is that of the first lane.
#[inline(always)]
pub(crate) fn check_means<S: Real>(
    means: &[S],
    env: u32,
    step: usize,
    agent: usize,
) -> Result<(), EpisodeError> {
    for (action, mean) in means.iter().enumerate() {
        if !mean.abs().le(S::splat(f64::from(f32::MAX))).all() {
            for lane in 0..S::LANES {
                let value = mean.lane(lane);
                if !value.is_finite() {
                    let env = env + lane as u32;
                    return Err(EpisodeError::Action {
                        env,
                        step,
                        agent,
                        action,
                        value,
                        moment: None,
                    });
                }
            }
        }
    }
    Ok(())
}

/// Largest sensible magnitudes. Nothing physical comes near them: the servos command at most a few
/// rad/s, and momentum is conserved.
pub(crate) const LIMITS: [(&str, f64); 6] = [
    ("base position (m)", 1e3),
    ("base quaternion", 1.1),
    ("base velocity (m/s)", 1e3),
    ("base angular velocity (rad/s)", 1e3),
    ("joint angle (rad)", 1e4),
    ("joint rate (rad/s)", 1e3),
];

/// Refuses a state with a number that is none or beyond all bounds.
///
/// The group's first lane holds local environment `group` of `n_envs`, the shard's first one has
/// the global index `first`.
#[inline(always)]
pub(crate) fn check_state<S: Real>(
    joints: &Joints,
    state: &State<S>,
    first: u32,
    group: usize,
    n_envs: usize,
    step: usize,
) -> Result<(), EpisodeError> {
    let parts: [&[S]; 6] = [
        &state.base_position,
        &state.base_quaternion,
        &state.base_linear_velocity,
        &state.base_angular_velocity,
        &state.q,
        &state.qd,
    ];
    let mut fine = S::Mask::splat(true);
    for (part, (_, limit)) in parts.iter().zip(LIMITS) {
        let limit = S::splat(limit);
        for x in *part {
            // False for NaN.
            fine = fine & x.abs().le(limit);
        }
    }
    if fine.all() {
        return Ok(());
    }
    for lane in 0..S::LANES.min(n_envs - group) {
        for (part, (quantity, limit)) in parts.iter().zip(LIMITS) {
            for (index, x) in part.iter().enumerate() {
                let value = x.lane(lane);
                if value.abs() <= limit {
                    continue;
                }
                let is_joint = quantity.starts_with("joint");
                return Err(EpisodeError::State {
                    env: first + (group + lane) as u32,
                    step,
                    agent: is_joint.then(|| joints.agent_of(index)),
                    quantity,
                    value,
                    limit,
                    moment: None,
                });
            }
        }
    }
    // Only repeated lanes are left, and they repeat a lane that was looked at.
    unreachable!("a lane beyond the last environment differs from the environment it repeats");
}
