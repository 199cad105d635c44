//! The rollout loop: many environments at once through whole episodes with a policy that explores.
//!
//! Rows of a block are written straight into the caller's memory, which is a loaned sample of shared
//! memory in a worker: turning lanes into rows is the write itself, there is no other copy.

use proto::config::Config;
use proto::layout::{Dimensions, JOINTS_PER_AGENT};

use super::explore::{Noise, Place, explore};
use super::extremes::Extremes;
use super::output::{Output, Row};
use super::start::scatter;
use crate::env::{EpisodeError, Physics, check_means, check_state};
use crate::policy::{Policy, Scratch};
use crate::robot::{JOINTS_PER_ARM, Robot};
use crate::scalar::{LaneFn, Real};
use crate::state::State;
use crate::task::goal::GoalAddress;
use crate::task::observation::observe;
use crate::task::reward::rewards;
use crate::task::state::critic_state;
use crate::task::{Errors, Goals, Readings, Task};

/// A part of a control step that has just ended, for who wants to measure it or to say that it is alive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Forward kinematics, contacts, rewards, observations and writing.
    Observed,
    /// Networks and sampling.
    Decided,
    /// Equations of motion; it ends the control step.
    Moved,
}

/// Environments `first..first + n_envs`, `n_steps` control steps each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Batch {
    pub(crate) first: u32,
    pub(crate) n_envs: usize,
    pub(crate) n_steps: usize,
}

/// Episodes to be played from their start to the end, exploring, as training wants them.
pub(crate) struct Episodes<'a> {
    pub(crate) config: &'a Config,
    pub(crate) robot: &'a Robot,
    pub(crate) task: &'a Task,
    pub(crate) dimensions: &'a Dimensions,
    pub(crate) policy: &'a Policy,
    pub(crate) batch: Batch,
    /// Address of the first environment's goals.
    pub(crate) goals: GoalAddress,
    /// Exploration.
    pub(crate) noise: Noise,
    pub(crate) output: Output<'a>,
    /// Called after every part of a control step; an episode ends with [`Stage::Observed`].
    pub(crate) on_stage: &'a mut dyn FnMut(Stage),
}

/// One lane group.
struct Group<S: Real> {
    state: State<S>,
    readings: Readings<S>,
    goals: Goals<S>,
    errors: Errors<S>,
    /// Clipped actions of the step and of the one before, one a joint.
    action: Vec<S>,
    last_action: Vec<S>,
    command: Vec<S>,
    extremes: Extremes<S>,
}

impl LaneFn for Episodes<'_> {
    type Output = Result<(), EpisodeError>;

    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let Self { config, robot, task, dimensions, policy, batch, goals, noise, .. } = self;
        let (mut output, on_stage) = (self.output, self.on_stage);
        let Dimensions { n_arms, n_agents, n_actors, observation: o, state: s, .. } = *dimensions;
        let agents_per_actor = dimensions.agents_per_actor();
        let (input, output_len) = (dimensions.actor_input(), dimensions.actor_output());
        let Batch { first, n_envs, n_steps } = batch;
        let n_groups = n_envs.div_ceil(S::LANES);

        let mut physics = Physics::<S>::new(config, robot);
        let mut groups: Vec<Group<S>> = (0..n_groups)
            .map(|group| {
                let mut drawn = task.goals.at_home();
                // Lanes beyond the last environment repeat it.
                let env_of =
                    |lane: usize| goals.env + (group * S::LANES + lane).min(n_envs - 1) as u32;
                for lane in 0..S::LANES {
                    let address = GoalAddress { env: env_of(lane), ..goals };
                    task.goals.draw(task.name, address, lane, &mut drawn);
                }
                let mut state = State::home(robot);
                let mut readings = Readings::new(n_arms);
                let begin = &config.task.start;
                scatter(begin, robot, &mut physics, &mut readings, (goals, env_of), &mut state);
                let joints = vec![S::zero(); n_arms * JOINTS_PER_ARM];
                Group {
                    state,
                    readings,
                    goals: drawn,
                    errors: Errors::new(n_arms),
                    action: joints.clone(),
                    last_action: joints.clone(),
                    command: joints,
                    extremes: Extremes::new(n_arms),
                }
            })
            .collect();
        // [P, group, input], [A, O], [group, output], [S], [A]
        let mut observations = vec![S::zero(); n_actors * n_groups * input];
        let mut group_observations = vec![S::zero(); n_agents * o];
        let mut means = vec![S::zero(); n_groups * output_len];
        let mut critic = vec![S::zero(); s];
        let mut paid = vec![S::zero(); n_agents];
        let mut scratch = Scratch::new(policy, n_groups);
        let limits: Vec<S> = task.action_limit.iter().map(|&limit| S::splat(limit)).collect();
        let scale = S::splat(task.action_scale);
        // What a diverged step began with, for the report.
        let mut before = State::<S>::home(robot);
        output.begin();

        for step in 0..=n_steps {
            for (index, group) in groups.iter_mut().enumerate() {
                let row = Row { group: index * S::LANES, n_envs, n_steps, dimensions };
                let touching = physics.read(&group.state, &mut group.readings);
                group.readings.last_action.copy_from_slice(&group.action);
                group.errors.update(&group.readings, &group.goals);
                if step > 0 {
                    rewards(
                        task,
                        &group.errors,
                        &group.action,
                        &group.last_action,
                        &touching,
                        &mut paid,
                    );
                    group.extremes.update(&group.errors, touching.pairs);
                    output.step(row, step - 1, &paid);
                }
                for agent in 0..n_agents {
                    let seen = &mut group_observations[agent * o..(agent + 1) * o];
                    observe(task, &group.readings, &group.goals, &group.errors, agent, seen);
                    // An actor sees its agents' observations one after the other.
                    let (actor, part) = (agent / agents_per_actor, agent % agents_per_actor);
                    let at = (actor * n_groups + index) * input + part * o;
                    observations[at..at + o].copy_from_slice(seen);
                }
                critic_state(
                    task,
                    &group.readings,
                    &group.errors,
                    &group_observations,
                    &mut critic,
                );
                output.look(row, step, &group_observations, &critic);
                if step == n_steps {
                    output.end(row, &group.errors, &group.extremes);
                }
                std::mem::swap(&mut group.action, &mut group.last_action);
            }
            on_stage(Stage::Observed);
            if step == n_steps {
                break;
            }

            for agent in 0..n_agents {
                let (actor, part) = (agent / agents_per_actor, agent % agents_per_actor);
                if part == 0 {
                    let of_actor = actor * n_groups * input..(actor + 1) * n_groups * input;
                    policy.mean(actor, &observations[of_actor], &mut scratch, &mut means);
                }
                for (index, group) in groups.iter_mut().enumerate() {
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
                    let log_prob = explore(policy, noise, place, &mut sample);
                    output.act(row, step, agent, &sample, log_prob);
                    for (u, sample) in sample.into_iter().enumerate() {
                        let joint = agent * JOINTS_PER_AGENT + u;
                        let clipped = sample.clamp(-limits[joint], limits[joint]);
                        group.action[joint] = clipped;
                        group.command[joint] = clipped * scale;
                    }
                }
            }
            on_stage(Stage::Decided);

            for (index, group) in groups.iter_mut().enumerate() {
                before.clone_from(&group.state);
                physics.step(&mut group.state, &group.command);
                let local = index * S::LANES;
                if let Err(error) = check_state(&group.state, first, local, n_envs, step) {
                    let env = first + local as u32;
                    return Err(error.keep(env, &before, &group.goals, &group.command));
                }
            }
            on_stage(Stage::Moved);
        }
        Ok(())
    }
}
