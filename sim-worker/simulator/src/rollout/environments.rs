//! Environments on their way, in lane groups: what a control step does to them, whoever acts.
//!
//! A rollout acts by a policy ([`Running`](super::running::Running)), a [`stepping::Batch`](crate::stepping::Batch) as
//! somebody outside says. Both go through here, and so make the same bits.

use proto::layout::{Dimensions, Joints};

use super::conditions::Conditions;
use super::lane_group::LaneGroup;
use crate::env::{EpisodeError, Physics, check_state};
use crate::model::Masses;
use crate::robot::Robot;
use crate::scalar::Real;
use crate::state::State;
use crate::step::StepOptions;
use crate::task::Task;
use crate::task::goal::GoalAddress;
use crate::task::observation::observe;
use crate::task::reward::rewards;
use crate::task::state::critic_state;

/// What is to be seen of the lane group that was looked at last.
pub(crate) struct Seen<S: Real> {
    /// `[A, O]`.
    pub(crate) observations: Vec<S>,
    /// `[S]`.
    pub(crate) critic: Vec<S>,
    /// `[A]`: rewards of the step before; of no meaning at the start.
    pub(crate) rewards: Vec<S>,
    /// Touching pairs.
    pub(crate) touching_pairs: S,
}

/// Lane groups with their physics.
pub(crate) struct Environments<S: Real> {
    physics: Physics<S>,
    pub(crate) groups: Vec<LaneGroup<S>>,
    pub(crate) seen: Seen<S>,
    joints: Joints,
    /// Limits of the actions, one a joint.
    limits: Vec<S>,
    scale: S,
    /// Time of a control step (s).
    period: f64,
    /// What a diverged step began with, for the report.
    before: State<S>,
}

impl<S: Real> Environments<S> {
    /// None yet.
    #[inline(always)]
    pub(crate) fn new(
        (robot, options): (&Robot, StepOptions),
        task: &Task,
        dimensions: &Dimensions,
    ) -> Self {
        let zeros = |n: usize| vec![S::zero(); n];
        Self {
            physics: Physics::with_options(robot, options),
            groups: Vec::new(),
            seen: Seen {
                observations: zeros(dimensions.n_agents * dimensions.observation),
                critic: zeros(dimensions.state),
                rewards: zeros(dimensions.n_agents),
                touching_pairs: S::zero(),
            },
            joints: robot.joints,
            limits: task.action_limit.iter().map(|&limit| S::splat(limit)).collect(),
            scale: S::splat(task.action_scale),
            period: task.control_period,
            before: State::home(robot),
        }
    }

    /// Begins `n_envs` episodes; `goals` is the address of the first one's.
    #[inline(always)]
    pub(crate) fn begin(
        &mut self,
        (robot, task): (&Robot, &Task),
        conditions: &Conditions,
        goals: GoalAddress,
        n_envs: usize,
    ) {
        let n_groups = n_envs.div_ceil(S::LANES);
        self.groups.clear();
        // Those before may have had other masses.
        self.physics.weigh(&Masses::of(robot));
        for group in 0..n_groups {
            let lanes = (group * S::LANES, n_envs);
            let Self { physics, groups, .. } = self;
            groups.push(LaneGroup::new((robot, task), conditions, physics, goals, lanes));
        }
    }

    /// Looks at what the step before led to in group `index`, after `step` steps.
    #[inline(always)]
    pub(crate) fn look(&mut self, task: &Task, dimensions: &Dimensions, index: usize, step: usize) {
        let Self { physics, groups, seen, limits, .. } = self;
        let group = &mut groups[index];
        let touching = physics.read(&group.state, &mut group.readings);
        group.readings.last_action.copy_from_slice(&group.action);
        group.errors.update(&group.readings, &group.goals);
        if step > 0 {
            let LaneGroup { errors, action, last_action, .. } = group;
            rewards(task, errors, action, last_action, &touching, &mut seen.rewards);
            group.extremes.update(&group.errors, touching.pairs);
        }
        seen.touching_pairs = touching.pairs;
        let o = dimensions.observation;
        let LaneGroup { readings, goals, errors, randomized, guidance, .. } = group;
        let sensed = match randomized {
            Some(erring) => erring.sense(readings, goals, step),
            None => None,
        };
        let (told, told_errors) = match sensed {
            Some((readings, errors)) => (readings, errors),
            None => (&*readings, &*errors),
        };
        for agent in 0..dimensions.n_agents {
            let to = &mut seen.observations[agent * o..(agent + 1) * o];
            observe(task, told, goals, told_errors, agent, to);
        }
        if let Some(postures) = &told_errors.postures {
            guidance.look(&postures.arms, task, task.action_scale, limits);
        }
        critic_state(task, readings, errors, &seen.observations, &mut seen.critic);
        std::mem::swap(&mut group.action, &mut group.last_action);
    }

    /// Has `agent` of group `index` do this in the next step: what it says is clipped and scaled.
    #[inline(always)]
    pub(crate) fn command(&mut self, index: usize, agent: usize, actions: &[S]) {
        let Self { groups, joints, limits, scale, .. } = self;
        let group = &mut groups[index];
        for (joint, action) in joints.of_agent(agent).zip(actions) {
            let acted = group.guidance.act(joint, *action);
            let clipped = acted.clamp(-limits[joint], limits[joint]);
            group.action[joint] = clipped;
            group.command[joint] = clipped * *scale;
        }
    }

    /// Holds the commands of all groups for a control period; `first` is the global index of the first of `n_envs` environments.
    ///
    /// # Errors
    /// If the simulation diverges.
    #[inline(always)]
    pub(crate) fn advance(
        &mut self,
        first: u32,
        n_envs: usize,
        step: usize,
    ) -> Result<(), EpisodeError> {
        let Self { physics, groups, joints, before, period, .. } = self;
        for (index, group) in groups.iter_mut().enumerate() {
            before.clone_from(&group.state);
            let LaneGroup { state, command, randomized, .. } = group;
            let executed = match randomized {
                Some(erring) => {
                    if let Some(masses) = &erring.masses {
                        physics.weigh(masses);
                    }
                    erring.drive(command)
                }
                None => command,
            };
            physics.step(state, executed);
            let local = index * S::LANES;
            if let Err(error) = check_state(joints, &group.state, first, local, n_envs, step) {
                let env = first + local as u32;
                return Err(error.keep(env, before, &group.goals, &group.command));
            }
            group.goals.advance(*period);
        }
        Ok(())
    }
}
