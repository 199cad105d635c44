//! Episodes on their way: the three parts of a control step.

use proto::agents::MAX_JOINTS_PER_AGENT;
use proto::layout::Dimensions;

use super::batch::{Batch, Episodes, Stage};
use super::conditions::Conditions;
use super::environments::Environments;
use super::explore::{Noise, Place, explore};
use super::output::{Output, Row};
use crate::env::{EpisodeError, check_means, step_options};
use crate::policy::{Policy, Scratch};
use crate::scalar::Real;
use crate::task::Task;

/// All lane groups of a batch, and the buffers between the parts of a step.
pub(super) struct Running<'a, S: Real> {
    task: &'a Task,
    dimensions: &'a Dimensions,
    policy: &'a Policy,
    batch: Batch,
    noise: Noise,
    output: Output<'a>,
    environments: Environments<S>,
    /// Where each actor's observations stand: actors that share a network stand side by side.
    places: Vec<usize>,
    /// `[place, group, input]`.
    observations: Vec<S>,
    /// `[actor, group, output]` of the actors of one network.
    means: Vec<S>,
    scratch: Scratch<S>,
}

impl<'a, S: Real> Running<'a, S> {
    /// Episodes at their beginning, and whom to tell what has ended.
    #[inline(always)]
    pub(super) fn new(episodes: Episodes<'a>) -> (Self, &'a mut dyn FnMut(Stage)) {
        let Episodes { config, robot, task, dimensions, policy, batch, goals, noise, .. } =
            episodes;
        let (mut output, on_stage) = (episodes.output, episodes.on_stage);
        let n_groups = batch.n_envs.div_ceil(S::LANES);
        let mut environments = Environments::new((robot, step_options(config)), task, dimensions);
        let conditions = Conditions::of_training(&config.task);
        environments.begin((robot, task), &conditions, goals, batch.n_envs);
        output.begin();
        let zeros = |n: usize| vec![S::zero(); n];
        let mut places = vec![0; dimensions.n_actors];
        for (place, &actor) in policy.sharing().iter().flatten().enumerate() {
            places[actor] = place;
        }
        let most = policy.sharing().iter().map(Vec::len).max().unwrap_or(0) * n_groups;
        let running = Self {
            places,
            observations: zeros(dimensions.n_actors * n_groups * dimensions.actor_input()),
            means: zeros(most * dimensions.actor_output()),
            scratch: Scratch::new(policy, most),
            task,
            dimensions,
            policy,
            batch,
            noise,
            output,
            environments,
        };
        (running, on_stage)
    }

    /// Looks at what the step before led to: rewards, observations, critic states, and at the end the episodes' metrics.
    #[inline(always)]
    pub(super) fn observe(&mut self, step: usize) {
        let Self { task, dimensions, output, environments, .. } = self;
        let Batch { n_envs, n_steps, .. } = self.batch;
        let n_groups = environments.groups.len();
        let (o, input) = (dimensions.observation, dimensions.actor_input());
        let agents_per_actor = dimensions.agents_per_actor();
        for index in 0..n_groups {
            let row = Row { group: index * S::LANES, n_envs, n_steps, dimensions };
            environments.look(task, dimensions, index, step);
            let (seen, group) = (&environments.seen, &environments.groups[index]);
            if step > 0 {
                output.step(row, step - 1, &seen.rewards);
            }
            for (agent, of_agent) in seen.observations.chunks_exact(o).enumerate() {
                // An actor sees its agents' observations one after the other.
                let (actor, part) = (agent / agents_per_actor, agent % agents_per_actor);
                let at = (self.places[actor] * n_groups + index) * input + part * o;
                self.observations[at..at + o].copy_from_slice(of_agent);
            }
            output.look(row, step, &seen.observations, &seen.critic);
            if step == n_steps {
                output.end(row, &group.errors, &group.extremes);
            }
        }
    }

    /// Has the actors decide, and explores.
    ///
    /// # Errors
    /// If an actor gives no number.
    #[inline(always)]
    pub(super) fn decide(&mut self, step: usize) -> Result<(), EpisodeError> {
        let Self { dimensions, policy, noise, output, environments, scratch, means, .. } = self;
        let Batch { first, n_envs, n_steps } = self.batch;
        let n_groups = environments.groups.len();
        let (input, output_len) = (dimensions.actor_input(), dimensions.actor_output());
        let (agents_per_actor, n_actions) = (dimensions.agents_per_actor(), dimensions.n_actions);
        let mut place = 0;
        for actors in policy.sharing() {
            let groups = actors.len() * n_groups;
            let seen = &self.observations[place * n_groups * input..][..groups * input];
            let means = &mut means[..groups * output_len];
            policy.mean(actors, seen, scratch, means);
            place += actors.len();
            let of_actors = means.chunks_exact(n_groups * output_len);
            for (&actor, means) in actors.iter().zip(of_actors) {
                for part in 0..agents_per_actor {
                    let agent = actor * agents_per_actor + part;
                    for index in 0..n_groups {
                        let row = Row { group: index * S::LANES, n_envs, n_steps, dimensions };
                        let at = index * output_len + part * n_actions;
                        let mean = &means[at..at + n_actions];
                        let env = first + row.group as u32;
                        if let Err(error) = check_means(mean, env, step, agent) {
                            let group = &environments.groups[index];
                            let (state, goals) = (&group.state, &group.goals);
                            return Err(error.keep(env, state, goals, &group.command));
                        }
                        // What there is no joint for stays zero.
                        let mut sample = [S::zero(); MAX_JOINTS_PER_AGENT];
                        let own = dimensions.joints.of_agent(agent).len();
                        sample[..own].copy_from_slice(&mean[..own]);
                        let place = Place { agent, first, row, step };
                        let log_prob = explore(policy, *noise, place, &mut sample[..own]);
                        output.act(row, step, agent, &sample[..n_actions], log_prob);
                        environments.command(index, agent, &sample[..own]);
                    }
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
        let Batch { first, n_envs, .. } = self.batch;
        self.environments.advance(first, n_envs, step)
    }
}
