//! The seat of a player: what it sees of all episodes, and what it decides.

use proto::agents::MAX_JOINTS_PER_AGENT;

use super::group::Group;
use super::trial::{actors, moves};
use super::{Driver, Player};
use crate::controller::{JacobianController, Memory};
use crate::env::EpisodeError;
use crate::policy::Scratch;
use crate::posture::Guidance;
use crate::rollout::World;
use crate::scalar::Real;
use crate::state::State;
use crate::task::observation::observe;
use crate::task::{Errors, Goals, Readings};

/// What sensors show of a lane group.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a, S: Real> {
    pub(super) readings: &'a Readings<S>,
    pub(super) errors: &'a Errors<S>,
    pub(super) goals: &'a Goals<S>,
}

/// A player's memory between seeing and deciding.
pub(super) enum Seat<S: Real> {
    /// Of a policy.
    Policy {
        /// Shape: `[P][group][agent of the actor][O]`.
        observations: Vec<S>,
        /// Shape: `[group][agent of the actor][U]`.
        means: Vec<S>,
        /// One a group.
        guidance: Vec<Guidance<S>>,
        inference: Scratch<S>,
    },
    /// Of a controller.
    Jacobian {
        /// Shape: `[group][lane]`.
        memories: Vec<Memory>,
        /// Joint rates that it wants (rad/s), shape: `[group][joint]`.
        rates: Vec<S>,
    },
}

impl<S: Real> Seat<S> {
    pub(super) fn new(player: &Player<'_>, n_groups: usize) -> Self {
        let dimensions = &player.world.dimensions;
        let zeros = |n: usize| vec![S::zero(); n];
        match player.driver {
            Driver::Policy(policy) => Self::Policy {
                observations: zeros(dimensions.n_actors * n_groups * dimensions.actor_input()),
                means: zeros(n_groups * dimensions.actor_output()),
                guidance: vec![Guidance::none(dimensions.joints.n_joints()); n_groups],
                inference: Scratch::new(policy, n_groups),
            },
            Driver::Jacobian(_) => Self::Jacobian {
                memories: vec![Memory::default(); n_groups * S::LANES],
                rates: zeros(n_groups * dimensions.joints.n_joints()),
            },
        }
    }

    /// Sees a lane group. `number` is the player's, as `arms` names it; `place` the group's index, how many there are, and how many episodes are
    /// left from its first one on.
    #[inline(always)]
    pub(super) fn look(
        &mut self,
        player: &Player<'_>,
        (number, arms): (usize, &[Option<usize>]),
        (seen, limits): (Seen<'_, S>, &[S]),
        (index, n_groups, left): (usize, usize, usize),
    ) {
        let World { task, dimensions, .. } = player.world;
        match (self, player.driver) {
            (Self::Policy { observations, guidance, .. }, _) => {
                if let Some(postures) = &seen.errors.postures {
                    guidance[index].look(&postures.arms, task, player.action_scale, limits);
                }
                let (o, agents_per_actor) = (dimensions.observation, dimensions.agents_per_actor());
                for actor in actors(arms, number, dimensions) {
                    for part in 0..agents_per_actor {
                        let agent = actor * agents_per_actor + part;
                        let at = ((actor * n_groups + index) * agents_per_actor + part) * o;
                        let out = &mut observations[at..at + o];
                        observe(task, seen.readings, seen.goals, seen.errors, agent, out);
                    }
                }
            }
            (Self::Jacobian { memories, rates }, Driver::Jacobian(controller)) => {
                let moves: Vec<bool> = arms.iter().map(|arm| *arm == Some(number)).collect();
                let n_joints = limits.len();
                let memories = &mut memories[index * S::LANES..(index + 1) * S::LANES];
                let rates = &mut rates[index * n_joints..(index + 1) * n_joints];
                control((controller, &moves), seen, left, memories, rates);
            }
            (Self::Jacobian { .. }, Driver::Policy(_)) => unreachable!("seated as it drives"),
        }
    }

    /// Decides on what was seen, for the arms that it moves; `first` is the first episode.
    ///
    /// # Errors
    /// If it decides on no number.
    #[inline(always)]
    pub(super) fn decide(
        &mut self,
        player: &Player<'_>,
        (number, arms): (usize, &[Option<usize>]),
        groups: &mut [Group<S>],
        limits: &[S],
        (first, step): (u32, usize),
    ) -> Result<(), EpisodeError> {
        let Player { world: World { dimensions, .. }, driver, action_scale } = player;
        let n_groups = groups.len();
        let env = |index: usize| first + (index * S::LANES) as u32;
        match (self, driver) {
            (Self::Policy { observations, means, guidance, inference }, Driver::Policy(policy)) => {
                let agents_per_actor = dimensions.agents_per_actor();
                let (input, output) = (dimensions.actor_input(), dimensions.actor_output());
                for actor in actors(arms, number, dimensions) {
                    let of_actor = actor * n_groups * input..(actor + 1) * n_groups * input;
                    policy.mean(&[actor], &observations[of_actor], inference, means);
                    for part in 0..agents_per_actor {
                        let agent = actor * agents_per_actor + part;
                        if !moves(arms, number, agent) {
                            continue;
                        }
                        for (index, group) in groups.iter_mut().enumerate() {
                            let joints = dimensions.joints.of_agent(agent);
                            let means = &means[index * output + part * dimensions.n_actions..];
                            let mut wanted = [S::zero(); MAX_JOINTS_PER_AGENT];
                            for u in 0..joints.len() {
                                wanted[u] = guidance[index].act(joints.start + u, means[u]);
                            }
                            let wanted = &wanted[..joints.len()];
                            group.act(agent, joints, wanted, limits, (env(index), step))?;
                        }
                    }
                }
            }
            (Self::Jacobian { rates, .. }, _) => {
                let per_action = S::splat(1.0 / action_scale);
                for (index, group) in groups.iter_mut().enumerate() {
                    let n_joints = group.action.len();
                    for agent in 0..dimensions.n_agents {
                        if moves(arms, number, agent) {
                            let joints = dimensions.joints.of_agent(agent);
                            let rates = &rates[index * n_joints + joints.start..];
                            let mut wanted = [S::zero(); MAX_JOINTS_PER_AGENT];
                            for u in 0..joints.len() {
                                wanted[u] = rates[u] * per_action;
                            }
                            let wanted = &wanted[..joints.len()];
                            group.act(agent, joints, wanted, limits, (env(index), step))?;
                        }
                    }
                }
            }
            (Self::Policy { .. }, Driver::Jacobian(_)) => unreachable!("seated as it drives"),
        }
        Ok(())
    }
}

/// Has a controller decide, lane by lane, on what sensors see; lanes beyond the last of `n` episodes repeat it.
fn control<S: Real>(
    (controller, moves): (&JacobianController, &[bool]),
    Seen { readings: seen, goals, .. }: Seen<'_, S>,
    n: usize,
    memories: &mut [Memory],
    rates: &mut [S],
) {
    for (lane, memory) in memories.iter_mut().enumerate().take(n) {
        let of = |values: &[S]| values.iter().map(|x| x.lane(lane)).collect::<Vec<f64>>();
        let state = State {
            base_position: seen.base_position.map(|x| x.lane(lane)),
            base_quaternion: seen.base_quaternion.map(|x| x.lane(lane)),
            base_linear_velocity: seen.base_linear.map(|x| x.lane(lane)),
            base_angular_velocity: seen.base_angular.map(|x| x.lane(lane)),
            q: of(&seen.q),
            qd: of(&seen.qd),
        };
        let hands = goals.hands.iter().map(|goal| goal.map(|x| x.lane(lane)));
        let goals = Goals::fixed(hands.collect(), goals.base.map(|x| x.lane(lane)));
        let found = controller.rates(&state, &goals, moves, memory);
        for lane in lane..if lane + 1 == n { S::LANES } else { lane + 1 } {
            for (slot, rate) in rates.iter_mut().zip(&found) {
                slot.set_lane(lane, *rate);
            }
        }
    }
}
