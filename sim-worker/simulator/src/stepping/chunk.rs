//! Some environments of a batch, in lanes: the unit of work of a thread.

use proto::agents::MAX_JOINTS_PER_AGENT;
use proto::layout::Dimensions;

use super::rows::{Rows, robot_width};
use crate::env::{EpisodeError, step_options};
use crate::rollout::World;
use crate::rollout::conditions::Conditions;
use crate::rollout::environments::Environments;
use crate::rollout::write_rows;
use crate::scalar::{Kernel, LaneFn, Real};
use crate::task::goal::GoalAddress;

/// Environments of one chunk, whatever lanes they stand in.
pub(super) trait Chunk: Send {
    /// Begins episodes, and shows them; `goals` is the address of the first one's.
    fn begin(&mut self, world: &World, conditions: &Conditions, goals: GoalAddress, rows: Rows<'_>);

    /// Holds `actions`, `[n, A, U]`, for a control period, and shows what it led to. On an error nothing is shown.
    fn step(
        &mut self,
        world: &World,
        actions: &[f32],
        step: usize,
        rows: Rows<'_>,
    ) -> Result<(), EpisodeError>;
}

/// Makes a chunk in the lanes it is run with.
pub(super) struct Make<'a> {
    pub(super) world: &'a World,
    pub(super) n_envs: usize,
}

impl LaneFn for Make<'_> {
    type Output = Box<dyn Chunk>;

    #[inline(always)]
    fn call<S: Real>(self) -> Self::Output {
        let Self { world, n_envs } = self;
        let World { config, robot, task, dimensions, .. } = world;
        let environments = Environments::<S>::new((robot, step_options(config)), task, dimensions);
        let robot = vec![S::zero(); robot_width(dimensions)];
        Box::new(InLanes { environments, n_envs, first: 0, robot })
    }
}

struct InLanes<S: Real> {
    environments: Environments<S>,
    n_envs: usize,
    /// Global index of the first environment.
    first: u32,
    /// The robots of a group, a row each.
    robot: Vec<S>,
}

impl<S: Real> Chunk for InLanes<S> {
    fn begin(
        &mut self,
        world: &World,
        conditions: &Conditions,
        goals: GoalAddress,
        rows: Rows<'_>,
    ) {
        S::compiled(BeginChunk { chunk: self, world, conditions, goals, rows });
    }

    fn step(
        &mut self,
        world: &World,
        actions: &[f32],
        step: usize,
        rows: Rows<'_>,
    ) -> Result<(), EpisodeError> {
        S::compiled(StepChunk { chunk: self, world, actions, step, rows })
    }
}

impl<S: Real> InLanes<S> {
    /// Has all agents do as `actions` say, `[n, A, U]`.
    #[inline(always)]
    fn command(&mut self, dimensions: &Dimensions, actions: &[f32]) {
        let Dimensions { n_agents, n_actions, joints, .. } = *dimensions;
        for index in 0..self.environments.groups.len() {
            for agent in 0..n_agents {
                let own = joints.of_agent(agent).len();
                let mut lanes = [S::zero(); MAX_JOINTS_PER_AGENT];
                for lane in 0..S::LANES {
                    // Lanes beyond the last environment repeat it.
                    let env = (index * S::LANES + lane).min(self.n_envs - 1);
                    let at = (env * n_agents + agent) * n_actions;
                    for u in 0..own {
                        lanes[u].set_lane(lane, f64::from(actions[at + u]));
                    }
                }
                self.environments.command(index, agent, &lanes[..own]);
            }
        }
    }

    /// Looks at everything, and writes it down.
    #[inline(always)]
    fn show(&mut self, world: &World, rows: &mut Rows<'_>, step: usize) {
        let Self { environments, n_envs, robot, .. } = self;
        let World { task, dimensions, .. } = world;
        for index in 0..environments.groups.len() {
            environments.look(task, dimensions, index, step);
            let (seen, group) = (&environments.seen, &environments.groups[index]);
            let first = index * S::LANES;
            let n = *n_envs - first;
            put(rows.observation, (first, n), &seen.observations);
            put(rows.state, (first, n), &seen.critic);
            if step > 0 {
                put(rows.reward, (first, n), &seen.rewards);
            }
            put(rows.position_error, (first, n), &group.errors.position_norm);
            put(rows.orientation_error, (first, n), &group.errors.orientation_norm);
            put(rows.base_error, (first, n), &[group.errors.base_norm]);
            put(rows.touching_pairs, (first, n), &[seen.touching_pairs]);
            put(rows.hand_goal, (first, n), group.goals.hands.as_flattened());
            put(rows.base_goal, (first, n), &group.goals.base);
            let mut at = 0;
            for part in group.state.parts() {
                robot[at..at + part.len()].copy_from_slice(part);
                at += part.len();
            }
            put(rows.robot, (first, n), robot);
        }
    }
}

/// Writes lanes as rows `first…` of an array, `n` of them at most.
#[inline(always)]
fn put<S: Real>(array: &mut [f32], (first, n): (usize, usize), features: &[S]) {
    write_rows(&mut array[first * features.len()..], n, features);
}

// Compiled for the processor's vectors, as what they call is.

struct BeginChunk<'a, S: Real> {
    chunk: &'a mut InLanes<S>,
    world: &'a World,
    conditions: &'a Conditions,
    goals: GoalAddress,
    rows: Rows<'a>,
}

impl<S: Real> Kernel<S> for BeginChunk<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { chunk, world, conditions, goals, mut rows } = self;
        chunk.first = goals.env;
        chunk.environments.begin((&world.robot, &world.task), conditions, goals, chunk.n_envs);
        rows.reward.fill(0.0);
        chunk.show(world, &mut rows, 0);
    }
}

struct StepChunk<'a, S: Real> {
    chunk: &'a mut InLanes<S>,
    world: &'a World,
    actions: &'a [f32],
    step: usize,
    rows: Rows<'a>,
}

impl<S: Real> Kernel<S> for StepChunk<'_, S> {
    type Output = Result<(), EpisodeError>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { chunk, world, actions, step, mut rows } = self;
        chunk.command(&world.dimensions, actions);
        chunk.environments.advance(chunk.first, chunk.n_envs, step)?;
        chunk.show(world, &mut rows, step + 1);
        Ok(())
    }
}
