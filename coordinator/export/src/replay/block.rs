//! A block, made again from its actions.

use std::sync::Arc;

use proto::layout::Dimensions;
use simulator::executor::Executor;
use simulator::rollout::Erring;
use simulator::stepping::{ARRAYS, Batch, Begin, GoalKind, Rows, StepError};

use super::comparison::Replay;
use crate::block::{Block, BlockAddress};
use crate::error::ExportError;

/// What environments show, in memory of ours.
struct Shown {
    arrays: [Vec<f32>; ARRAYS],
}

impl Shown {
    fn new(n_envs: usize, dimensions: &Dimensions) -> Self {
        Self { arrays: Rows::widths(dimensions).map(|width| vec![0.0; n_envs * width]) }
    }

    fn rows(&mut self) -> Rows<'_> {
        Rows::of_arrays(self.arrays.each_mut().map(Vec::as_mut_slice))
    }

    /// Row `env` of an array, one of `n_envs`.
    fn row(&self, array: usize, env: usize, n_envs: usize) -> &[f32] {
        let width = self.arrays[array].len() / n_envs;
        &self.arrays[array][env * width..(env + 1) * width]
    }
}

// Places in `Rows`.
const OBSERVATION: usize = 0;
const STATE: usize = 1;
const REWARD: usize = 2;
const HAND_GOAL: usize = 7;
const BASE_GOAL: usize = 8;
const ROBOT: usize = 9;

fn failed(error: &StepError) -> ExportError {
    ExportError::Episode(error.to_string())
}

/// The episodes of a shard's environments `first…`.
fn begin(address: BlockAddress, first: usize) -> Result<Begin, ExportError> {
    let BlockAddress { seed, iteration, .. } = address;
    let number = |what: &str, n: u64| {
        let message = || ExportError::Episode(format!("{what} {n} is beyond all addresses"));
        u32::try_from(n).map_err(|_| message())
    };
    Ok(Begin {
        seed,
        iteration: number("iteration", iteration)?,
        first: number("environment", first as u64)?,
        goals: GoalKind::Training,
    })
}

/// Where an environment begins, and what errs in it.
#[derive(Debug)]
pub struct BlockStart {
    /// Numbers of the robot's state.
    pub robot: Vec<f32>,
    /// Goals of the hands: position (m) and Euler angles (rad), world; at the beginning and, where they move, after every control step.
    pub hands: Vec<Vec<[f32; 6]>>,
    /// Goal of the base: Euler angles (rad).
    pub base: [f32; 3],
    /// Its drives and masses, if they can err in this training.
    pub erring: Option<Erring>,
}

/// Where environment `env` of a block begins.
///
/// # Errors
/// If the address is none, or the environment diverges.
pub fn block_start(
    block: &Block,
    env: usize,
    executor: &dyn Executor,
) -> Result<BlockStart, ExportError> {
    let Block { world, address, .. } = block;
    let Dimensions { n_agents, n_steps, n_envs, n_actions: width, .. } = world.dimensions;
    let mut shown = Shown::new(1, &world.dimensions);
    let mut batch = Batch::new(Arc::clone(world), 1, 1);
    let begin = begin(*address, address.shard as usize * n_envs + env)?;
    let erring = Erring::of_training(world, begin.seed, begin.iteration, begin.first);
    batch.reset(begin, executor, shown.rows()).map_err(|error| failed(&error))?;
    let robot = shown.row(ROBOT, 0, 1).to_vec();
    let base = shown.row(BASE_GOAL, 0, 1).try_into().expect("three numbers");
    let hands_of = |shown: &Shown| {
        let goals = shown.row(HAND_GOAL, 0, 1).chunks_exact(6);
        goals.map(|goal| goal.try_into().expect("six numbers")).collect()
    };
    let mut hands: Vec<Vec<[f32; 6]>> = vec![hands_of(&shown)];
    // Where they go does not depend on the robot, which does again what it did.
    for step in 0..if world.task.name.moves() { n_steps } else { 0 } {
        let of_agent = |agent| &block.actions(agent, step)[env * width..(env + 1) * width];
        let actions: Vec<f32> = (0..n_agents).flat_map(of_agent).copied().collect();
        batch.step(&actions, executor, shown.rows()).map_err(|error| failed(&error))?;
        hands.push(hands_of(&shown));
    }
    Ok(BlockStart { robot, hands, base, erring })
}

/// Makes a block again from its actions, up to the first control step in which a number differs: observations, what critics see, rewards and ends
/// of episodes. Probabilities of the actions need the policy, and are not compared. The batch is made for so many `threads` of `executor`.
///
/// # Errors
/// If an environment diverges or the address is none.
pub fn replay_block(
    block: &Block,
    executor: &dyn Executor,
    threads: usize,
) -> Result<Replay, ExportError> {
    let world = &block.world;
    let Dimensions { n_agents, n_steps, n_envs, n_actions: width, .. } = world.dimensions;
    let mut shown = Shown::new(n_envs, &world.dimensions);
    let mut batch = Batch::new(Arc::clone(world), n_envs, threads);
    let begin = begin(block.address, block.address.shard as usize * n_envs)?;
    batch.reset(begin, executor, shown.rows()).map_err(|error| failed(&error))?;
    let mut replay = Replay::new(n_steps);
    if !compare_seen(&mut replay, block, &shown, 0) {
        return Ok(replay);
    }
    let mut actions = vec![0.0; n_envs * n_agents * width];
    for step in 0..n_steps {
        for agent in 0..n_agents {
            let of_agent = block.actions(agent, step).chunks_exact(width);
            for (env, action) in of_agent.enumerate() {
                let at = (env * n_agents + agent) * width;
                actions[at..at + width].copy_from_slice(action);
            }
        }
        batch.step(&actions, executor, shown.rows()).map_err(|error| failed(&error))?;
        if !compare_seen(&mut replay, block, &shown, step + 1)
            || !compare_paid(&mut replay, block, &shown, step)
        {
            break;
        }
    }
    Ok(replay)
}

/// Holds what is seen after so many control steps against the block.
fn compare_seen(replay: &mut Replay, block: &Block, shown: &Shown, step: usize) -> bool {
    let (layout, dimensions) = (block.world.block_layout(), &block.world.dimensions);
    let Dimensions { n_agents, n_steps, n_envs, observation: o, state: s, .. } = *dimensions;
    for env in 0..n_envs {
        let seen = shown.row(OBSERVATION, env, n_envs).chunks_exact(o);
        for (agent, seen) in seen.enumerate().take(n_agents) {
            let at = layout.observation.start + ((agent * (n_steps + 1) + step) * n_envs + env) * o;
            let name = |index| format!("environment {env}, agent {agent}: observation {index}");
            if !replay.compare(step, &block.numbers[at..at + o], seen, name) {
                return false;
            }
        }
        let at = layout.state.start + (step * n_envs + env) * s;
        let name = |index| format!("environment {env}: state {index} of the critics");
        let seen = shown.row(STATE, env, n_envs);
        if !replay.compare(step, &block.numbers[at..at + s], seen, name) {
            return false;
        }
    }
    true
}

/// Holds what control step `step`, counted from 0, paid against the block, and whether it was the last.
fn compare_paid(replay: &mut Replay, block: &Block, shown: &Shown, step: usize) -> bool {
    let (layout, dimensions) = (block.world.block_layout(), &block.world.dimensions);
    let Dimensions { n_agents, n_steps, n_envs, .. } = *dimensions;
    let over = f32::from(u8::from(step + 1 == n_steps));
    for env in 0..n_envs {
        for (agent, reward) in shown.row(REWARD, env, n_envs).iter().enumerate().take(n_agents) {
            let at = layout.reward.start + (agent * n_steps + step) * n_envs + env;
            let name = |_| format!("environment {env}, agent {agent}: reward");
            if !replay.compare(step + 1, &block.numbers[at..=at], &[*reward], name) {
                return false;
            }
        }
        for (what, array, now) in
            [("terminated", &layout.terminated, 0.0), ("truncated", &layout.truncated, over)]
        {
            let at = array.start + step * n_envs + env;
            let name = |_| format!("environment {env}: {what}");
            if !replay.compare(step + 1, &block.numbers[at..=at], &[now], name) {
                return false;
            }
        }
    }
    true
}
