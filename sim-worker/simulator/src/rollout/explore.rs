//! How actions depart from what actors say, by numbers that are drawn by address.

use proto::agents::MAX_JOINTS_PER_AGENT;
use proto::config::Exploration;
use proto::rng::{Address, Purpose};

use super::output::Row;
use crate::policy::Policy;
use crate::scalar::Real;

/// ½ ln 2π.
const HALF_LN_TAU: f64 = 0.918_938_533_204_672_8;

/// Address of exploration noise, less environment, step and agent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Noise {
    pub(crate) seed: u64,
    pub(crate) iteration: u32,
    /// How deterministic actors explore; others draw from their own distribution.
    pub(crate) exploration: Option<Exploration>,
}

/// Which actions: those of `agent` in `step`, in the environments of `row`; `first` is the global index
/// of the batch's first.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    pub(crate) agent: usize,
    pub(crate) first: u32,
    pub(crate) row: Row<'a>,
    pub(crate) step: usize,
}

impl Place<'_> {
    #[inline(always)]
    fn address(&self, noise: Noise, purpose: Purpose, lane: usize) -> Address {
        Address {
            seed: noise.seed,
            purpose,
            iteration: noise.iteration,
            env: self.first + (self.row.group + lane) as u32,
            step: self.step as u32,
            index: self.agent as u32,
        }
    }
}

/// Turns what an actor says into actions, in `sample`, one a joint of the agent; returns the logarithms of their probability
/// densities, zero for deterministic actors.
#[inline(always)]
pub(crate) fn explore<S: Real>(
    policy: &Policy,
    noise: Noise,
    place: Place<'_>,
    sample: &mut [S],
) -> S {
    match noise.exploration {
        None => draw(policy, noise, place, sample),
        Some(exploration) => {
            perturb(exploration, noise, place, sample);
            S::zero()
        }
    }
}

/// Adds a stochastic actor's own noise to its means; returns log-probabilities of the samples.
///
/// log p = Σ −½((a − μ)/σ)² − ln σ − ½ ln 2π, taken from the rounded action, as the learner will.
#[inline(always)]
fn draw<S: Real>(policy: &Policy, noise: Noise, place: Place<'_>, sample: &mut [S]) -> S {
    let Place { agent, row, .. } = place;
    let mut drawn = [S::zero(); MAX_JOINTS_PER_AGENT];
    let mut normals = [0.0; 4];
    for lane in 0..S::LANES {
        if row.group + lane < row.n_envs {
            normals = place.address(noise, Purpose::ActionNoise, lane).normals();
        }
        for (drawn, normal) in drawn.iter_mut().zip(normals) {
            drawn.set_lane(lane, f64::from(normal));
        }
    }
    let mut log_prob = S::zero();
    for u in 0..sample.len() {
        let std = S::splat(f64::from(policy.std(agent)[u]));
        let constant = f64::from(policy.log_std(agent)[u]) + HALF_LN_TAU;
        let mean = sample[u];
        sample[u] = std.mul_add(drawn[u], mean);
        let z = (sample[u] - mean) / std;
        log_prob = (z * z).mul_add(S::splat(-0.5), log_prob) - S::splat(constant);
    }
    log_prob
}

/// Perturbs a deterministic actor's actions by normal noise, or replaces all of the agent's actions by
/// uniform ones, and keeps them within the limit.
#[inline(always)]
fn perturb<S: Real>(exploration: Exploration, noise: Noise, place: Place<'_>, sample: &mut [S]) {
    let Exploration { limit, std, random } = exploration;
    let mut normals = [0.0; MAX_JOINTS_PER_AGENT];
    let mut uniforms = [1.0; 1 + MAX_JOINTS_PER_AGENT];
    for lane in 0..S::LANES {
        // Lanes beyond the last environment repeat it.
        if place.row.group + lane < place.row.n_envs {
            normals = place.address(noise, Purpose::ActionNoise, lane).normals();
            let first = place.address(noise, Purpose::RandomAction, lane);
            uniforms[..4].copy_from_slice(&first.uniforms());
            if sample.len() > 3 {
                // The choice and three actions take up a group of four; agents are far fewer than this.
                let second = Address { index: first.index + (1 << 16), ..first };
                uniforms[4..].copy_from_slice(&second.uniforms()[..1]);
            }
        }
        let [choice, uniforms @ ..] = uniforms;
        for ((action, normal), uniform) in sample.iter_mut().zip(normals).zip(uniforms) {
            let explored = if f64::from(choice) < random {
                limit * (2.0 * f64::from(uniform) - 1.0)
            } else {
                action.lane(lane) + std * f64::from(normal)
            };
            action.set_lane(lane, explored.clamp(-limit, limit));
        }
    }
}
