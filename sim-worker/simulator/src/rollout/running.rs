//! Episodes on their way: the three parts of a control step.

use proto::layout::{Dimensions, JOINTS_PER_AGENT};

use super::batch::{Batch, Episodes, Stage};
use super::explore::{Noise, Place, explore};
use super::lane_group::LaneGroup;
use super::output::{Output, Row};
use crate::env::{EpisodeError, Physics, check_means, check_state};
use crate::policy::{Policy, Scratch};
use crate::scalar::Real;
use crate::state::State;
use crate::task::Task;
use crate::task::observation::observe;
use crate::task::reward::rewards;
use crate::task::state::critic_state;

/// All lane groups of a batch, and the buffers between the parts of a step.
pub(super) struct Running<'a, S: Real> {
    task: &'a Task,
    dimensions: &'a Dimensions,
    policy: &'a Policy,
    batch: Batch,
    noise: Noise,
    output: Output<'a>,
    physics: Physics<S>,
    groups: Vec<LaneGroup<S>>,
    /// `[P, group, input]`.
    observations: Vec<S>,
    /// `[A, O]` of one group.
    group_observations: Vec<S>,
    /// `[group, output]` of one actor.
    means: Vec<S>,
    /// `[S]`.
    critic: Vec<S>,
    /// `[A]`.
    paid: Vec<S>,
    scratch: Scratch<S>,
    /// Limits of the actions, one a joint.
    limits: Vec<S>,
    scale: S,
    /// What a diverged step began with, for the report.
    before: State<S>,
}

impl<'a, S: Real> Running<'a, S> {
    /// Episodes at their beginning, and whom to tell what has ended.
    #[inline(always)]
    pub(super) fn new(episodes: Episodes<'a>) -> (Self, &'a mut dyn FnMut(Stage)) {
        let Episodes { config, robot, task, dimensions, policy, batch, goals, noise, .. } =
            episodes;
        let (mut output, on_stage) = (episodes.output, episodes.on_stage);
        let n_groups = batch.n_envs.div_ceil(S::LANES);
        let mut physics = Physics::<S>::new(config, robot);
        let mut groups = Vec::with_capacity(n_groups);
        for group in 0..n_groups {
            let lanes = (group * S::LANES, batch.n_envs);
            let start = &config.task.start;
            groups.push(LaneGroup::new((robot, task), start, &mut physics, goals, lanes));
        }
        output.begin();
        let zeros = |n: usize| vec![S::zero(); n];
        let running = Self {
            observations: zeros(dimensions.n_actors * n_groups * dimensions.actor_input()),
            group_observations: zeros(dimensions.n_agents * dimensions.observation),
            means: zeros(n_groups * dimensions.actor_output()),
            critic: zeros(dimensions.state),
            paid: zeros(dimensions.n_agents),
            scratch: Scratch::new(policy, n_groups),
            limits: task.action_limit.iter().map(|&limit| S::splat(limit)).collect(),
            scale: S::splat(task.action_scale),
            before: State::home(robot),
            task,
            dimensions,
            policy,
            batch,
            noise,
            output,
            physics,
            groups,
        };
        (running, on_stage)
    }

    /// Looks at what the step before led to: rewards, observations, critic states, and at the end the episodes' metrics.
    #[inline(always)]
    pub(super) fn observe(&mut self, step: usize) {
        let Self { task, dimensions, output, physics, critic, paid, .. } = self;
        let group_observations = &mut self.group_observations;
        let Batch { n_envs, n_steps, .. } = self.batch;
        let (o, input, n_groups) =
            (dimensions.observation, dimensions.actor_input(), self.groups.len());
        let agents_per_actor = dimensions.agents_per_actor();
        for (index, group) in self.groups.iter_mut().enumerate() {
            let row = Row { group: index * S::LANES, n_envs, n_steps, dimensions };
            let touching = physics.read(&group.state, &mut group.readings);
            group.readings.last_action.copy_from_slice(&group.action);
            group.errors.update(&group.readings, &group.goals);
            if step > 0 {
                rewards(task, &group.errors, &group.action, &group.last_action, &touching, paid);
                group.extremes.update(&group.errors, touching.pairs);
                output.step(row, step - 1, paid);
            }
            for agent in 0..dimensions.n_agents {
                let seen = &mut group_observations[agent * o..(agent + 1) * o];
                observe(task, &group.readings, &group.goals, &group.errors, agent, seen);
                // An actor sees its agents' observations one after the other.
                let (actor, part) = (agent / agents_per_actor, agent % agents_per_actor);
                let at = (actor * n_groups + index) * input + part * o;
                self.observations[at..at + o].copy_from_slice(seen);
            }
            critic_state(task, &group.readings, &group.errors, group_observations, critic);
            output.look(row, step, group_observations, critic);
            if step == n_steps {
                output.end(row, &group.errors, &group.extremes);
            }
            std::mem::swap(&mut group.action, &mut group.last_action);
        }
    }

    /// Has the actors decide, and explores.
    ///
    /// # Errors
    /// If an actor gives no number.
    #[inline(always)]
    pub(super) fn decide(&mut self, step: usize) -> Result<(), EpisodeError> {
        let Self { dimensions, policy, noise, output, limits, scale, scratch, means, .. } = self;
        let Batch { first, n_envs, n_steps } = self.batch;
        let (input, output_len, n_groups) =
            (dimensions.actor_input(), dimensions.actor_output(), self.groups.len());
        let agents_per_actor = dimensions.agents_per_actor();
        for agent in 0..dimensions.n_agents {
            let (actor, part) = (agent / agents_per_actor, agent % agents_per_actor);
            if part == 0 {
                let of_actor = actor * n_groups * input..(actor + 1) * n_groups * input;
                policy.mean(actor, &self.observations[of_actor], scratch, means);
            }
            for (index, group) in self.groups.iter_mut().enumerate() {
                let row = Row { group: index * S::LANES, n_envs, n_steps, dimensions };
                let at = index * output_len + part * JOINTS_PER_AGENT;
                let mean = &means[at..at + JOINTS_PER_AGENT];
                let env = first + row.group as u32;
                if let Err(error) = check_means(mean, env, step, agent) {
                    return Err(error.keep(env, &group.state, &group.goals, &group.command));
                }
                let mut sample = [S::zero(); JOINTS_PER_AGENT];
                sample.copy_from_slice(mean);
                let place = Place { agent, first, row, step };
                let log_prob = explore(policy, *noise, place, &mut sample);
                output.act(row, step, agent, &sample, log_prob);
                for (u, sample) in sample.into_iter().enumerate() {
                    let joint = agent * JOINTS_PER_AGENT + u;
                    let clipped = sample.clamp(-limits[joint], limits[joint]);
                    group.action[joint] = clipped;
                    group.command[joint] = clipped * *scale;
                }
            }
        }
        Ok(())
    }

    /// Holds the commands for a control period.
    ///
    /// # Errors
    /// If the simulation diverges.
    #[inline(always)]
    pub(super) fn advance(&mut self, step: usize) -> Result<(), EpisodeError> {
        let Self { physics, groups, before, .. } = self;
        let Batch { first, n_envs, .. } = self.batch;
        for (index, group) in groups.iter_mut().enumerate() {
            before.clone_from(&group.state);
            physics.step(&mut group.state, &group.command);
            let local = index * S::LANES;
            if let Err(error) = check_state(&group.state, first, local, n_envs, step) {
                let env = first + local as u32;
                return Err(error.keep(env, before, &group.goals, &group.command));
            }
        }
        Ok(())
    }
}
