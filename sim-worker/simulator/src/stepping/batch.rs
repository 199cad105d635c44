//! Environments that are stepped together.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use proto::layout::Dimensions;
use proto::rng::Purpose;

use super::chunk::{Chunk, Make};
use super::{Rows, StepError};
use crate::env::EpisodeError;
use crate::executor::{self, Executor};
use crate::rollout::World;
use crate::rollout::conditions::Conditions;
use crate::scalar::{Backend, LANES, dispatch_for};
use crate::task::goal::GoalAddress;

/// Lane groups of a chunk, at most.
const MOST_GROUPS: usize = 4;

/// Which goals are drawn, and where episodes begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalKind {
    /// Those of training; starts as `task.start` says, and what errs as `task.randomization` says.
    Training,
    /// Held out: those of evaluations, which begin at home and in which nothing errs. Their iteration is 0, their environment the episode.
    Evaluation,
}

/// Which episodes begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Begin {
    /// Seed of the run, or of the evaluation.
    pub seed: u64,
    /// Iteration of the run; an evaluation has none.
    pub iteration: u32,
    /// Global index of the first environment.
    pub first: u32,
    /// Which goals.
    pub goals: GoalKind,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Course {
    NotBegun,
    /// Steps made.
    At(usize),
    Unfinished,
}

/// Environments that are stepped together, one episode each.
///
/// All episodes are equally long, so they begin and end together. Environments never mix: how many there are, and what executes
/// them, changes no bit.
pub struct Batch {
    world: Arc<World>,
    n_envs: usize,
    /// Environments of a chunk, and the chunks.
    per_chunk: usize,
    chunks: Vec<Box<dyn Chunk>>,
    course: Course,
}

impl std::fmt::Debug for Batch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { n_envs, course, .. } = self;
        f.debug_struct("Batch")
            .field("n_envs", n_envs)
            .field("course", course)
            .finish_non_exhaustive()
    }
}

impl Batch {
    /// `n_envs` environments, in chunks that keep `threads` busy.
    ///
    /// # Panics
    /// Without environments.
    pub fn new(world: Arc<World>, n_envs: usize, threads: usize) -> Self {
        Self::on(Backend::detect(), world, n_envs, threads)
    }

    /// [`Batch::new`] on a chosen back end; all give the same bits.
    pub fn on(backend: Backend, world: Arc<World>, n_envs: usize, threads: usize) -> Self {
        assert!(n_envs > 0, "a batch has environments");
        let groups = n_envs.div_ceil(LANES).div_ceil(threads.max(1)).min(MOST_GROUPS);
        let per_chunk = groups * LANES;
        let sizes = (0..n_envs).step_by(per_chunk).map(|first| per_chunk.min(n_envs - first));
        let chunks =
            sizes.map(|n_envs| dispatch_for(n_envs, backend, Make { world: &world, n_envs }));
        let chunks = chunks.collect();
        Self { world, n_envs, per_chunk, chunks, course: Course::NotBegun }
    }

    /// What the environments share.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// N: environments.
    pub fn n_envs(&self) -> usize {
        self.n_envs
    }

    /// Steps since the start, if an episode has begun and can go on, or is over.
    pub fn steps(&self) -> Option<usize> {
        match self.course {
            Course::At(steps) => Some(steps),
            Course::NotBegun | Course::Unfinished => None,
        }
    }

    /// Whether the episodes are over.
    pub fn is_over(&self) -> bool {
        self.course == Course::At(self.world.dimensions.n_steps)
    }

    /// Begins other episodes, and shows them in `rows`.
    ///
    /// # Errors
    /// If `rows` are of other sizes, environments have no address, or the executor gives up.
    pub fn reset(
        &mut self,
        begin: Begin,
        executor: &dyn Executor,
        rows: Rows<'_>,
    ) -> Result<(), StepError> {
        rows.check(self.n_envs, &self.world.dimensions)?;
        let last = u64::from(begin.first) + self.n_envs as u64 - 1;
        if u32::try_from(last).is_err() {
            return Err(StepError::NoSuchEnvironment { last });
        }
        let world = Arc::clone(&self.world);
        let Begin { seed, iteration, first, goals } = begin;
        let (purpose, conditions) = match goals {
            GoalKind::Training => (Purpose::Goal, Conditions::of_training(&world.config.task)),
            GoalKind::Evaluation => (Purpose::EvaluationGoal, Conditions::default()),
        };
        let goals = GoalAddress { seed, purpose, iteration, env: first };
        self.each(executor, rows, |chunk, first, rows| {
            let goals = GoalAddress { env: goals.env + first as u32, ..goals };
            chunk.begin(&world, &conditions, goals, rows);
            Ok(())
        })?;
        self.course = Course::At(0);
        Ok(())
    }

    /// Holds `actions`, `[N, A, U]`, for a control period, and shows in `rows` what it led to.
    ///
    /// Actions are clipped at the joints' limits and scaled by `task.action_scale`, as in training.
    ///
    /// # Errors
    /// If arrays are of other sizes, an action is no number or there is no episode that goes on: then nothing has changed. If an
    /// environment diverges or the executor gives up: then the batch must be reset.
    pub fn step(
        &mut self,
        actions: &[f32],
        executor: &dyn Executor,
        rows: Rows<'_>,
    ) -> Result<(), StepError> {
        let world = Arc::clone(&self.world);
        let Dimensions { n_agents, n_actions, .. } = world.dimensions;
        let width = n_agents * n_actions;
        rows.check(self.n_envs, &world.dimensions)?;
        let (found, expected) = (actions.len(), self.n_envs * width);
        if found != expected {
            return Err(StepError::Length { what: "actions", found, expected });
        }
        let step = match self.course {
            Course::NotBegun => return Err(StepError::NotBegun),
            Course::Unfinished => return Err(StepError::Unfinished),
            Course::At(steps) if steps == world.dimensions.n_steps => {
                return Err(StepError::Over { steps });
            }
            Course::At(steps) => steps,
        };
        if let Some(at) = actions.iter().position(|action| !action.is_finite()) {
            let (env, rest, value) = (at / width, at % width, actions[at]);
            let (agent, action) = (rest / n_actions, rest % n_actions);
            return Err(StepError::Action { env, agent, action, value });
        }
        self.each(executor, rows, |chunk, first, rows| {
            chunk.step(&world, &actions[first * width..], step, rows)
        })?;
        self.course = Course::At(step + 1);
        Ok(())
    }

    /// Does `work` on every chunk, given its first environment's index in the batch, and its rows.
    fn each(
        &mut self,
        executor: &dyn Executor,
        rows: Rows<'_>,
        work: impl Fn(&mut dyn Chunk, usize, Rows<'_>) -> Result<(), EpisodeError> + Sync,
    ) -> Result<(), StepError> {
        self.course = Course::Unfinished;
        let (n_envs, per_chunk) = (self.n_envs, self.per_chunk);
        let mut parts = Vec::with_capacity(self.chunks.len());
        let mut rest = rows;
        for (index, chunk) in self.chunks.iter_mut().enumerate() {
            let first = index * per_chunk;
            let (n, left) = (per_chunk.min(n_envs - first), n_envs - first);
            let (rows, others) = rest.split(n, left);
            rest = others;
            parts.push((chunk, first, rows));
        }
        let (n_parts, done) = (parts.len(), AtomicUsize::new(0));
        executor::for_each(executor, parts, |(chunk, first, rows)| {
            work(chunk.as_mut(), first, rows)?;
            done.fetch_add(1, Ordering::Relaxed);
            Ok::<(), EpisodeError>(())
        })?;
        if done.into_inner() < n_parts {
            return Err(StepError::Stopped);
        }
        Ok(())
    }
}
