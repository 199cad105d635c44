//! Batches beside blocks.

use std::sync::Arc;

use proto::config::{Layers, Preset, TaskName};
use proto::layout::Dimensions;

use super::*;
use crate::executor::tests::Apart;
use crate::executor::{Executor, InOrder};
use crate::policy::tests::parameters;
use crate::robot::Robot;
use crate::rollout::{RolloutSpec, World, rollout};
use crate::scalar::Backend;

/// A small world with `n_envs` environments in one shard, of which some begin away from home.
fn world(preset: Preset, task: TaskName, n_envs: usize, steps: usize) -> World {
    let mut config = Layers::new(preset, Some(task)).resolve().expect("valid");
    config.network.hidden = vec![16];
    config.env.n_envs = n_envs;
    config.env.n_shards = 1;
    config.task.episode_steps = steps;
    World::new(&config, &Robot::builtin("paper").expect("built in"))
}

/// The memory that [`Rows`] are lent from.
#[derive(Debug, PartialEq)]
struct Memory([Vec<f32>; ARRAYS]);

impl Memory {
    fn new(n: usize, dimensions: &Dimensions) -> Self {
        Self(Rows::widths(dimensions).map(|width| vec![f32::NAN; n * width]))
    }

    fn rows(&mut self) -> Rows<'_> {
        Rows::of_arrays(self.0.each_mut().map(Vec::as_mut_slice))
    }

    fn is_finite(&self) -> bool {
        self.0.iter().flatten().all(|x| x.is_finite())
    }
}

const BEGIN: Begin = Begin { seed: 5, iteration: 2, first: 0, goals: GoalKind::Training };

/// Everything that a batch shows when it is given the actions of a block, `[step][array]`; compared with the block on the way.
fn replay(world: &World, block: &[f32], mut batch: Batch, executor: &dyn Executor) -> Vec<Memory> {
    let layout = world.block_layout();
    let Dimensions { n_agents, n_steps, n_envs: n, n_actions: u, observation: o, state: s, .. } =
        world.dimensions;
    let mut shown = Vec::new();
    let mut memory = Memory::new(n, &world.dimensions);
    batch.reset(BEGIN, executor, memory.rows()).expect("episodes");
    for step in 0..=n_steps {
        for env in 0..n {
            for agent in 0..n_agents {
                let row = (agent * (n_steps + 1) + step) * n + env;
                let expected = &block[layout.observation.start + row * o..][..o];
                let found = &memory.0[0][(env * n_agents + agent) * o..][..o];
                assert!(found == expected, "step {step}, environment {env}, agent {agent}");
                if step > 0 {
                    let row = (agent * n_steps + step - 1) * n + env;
                    let found = memory.0[2][env * n_agents + agent];
                    assert_eq!(found, block[layout.reward.start + row], "reward");
                }
            }
            let expected = &block[layout.state.start + (step * n + env) * s..][..s];
            assert!(&memory.0[1][env * s..][..s] == expected, "state");
        }
        shown.push(Memory(memory.0.clone()));
        assert_eq!((batch.steps(), batch.is_over()), (Some(step), step == n_steps));
        if step == n_steps {
            break;
        }
        let mut actions = vec![0.0; n * n_agents * u];
        for (at, action) in actions.chunks_exact_mut(u).enumerate() {
            let (env, agent) = (at / n_agents, at % n_agents);
            let row = (agent * n_steps + step) * n + env;
            let from = layout.action.start + row * u;
            action.copy_from_slice(&block[from..from + u]);
        }
        batch.step(&actions, executor, memory.rows()).expect("a step");
    }
    shown
}

#[test]
fn the_actions_of_a_block_make_the_bits_of_the_block() {
    for (preset, task) in [
        (Preset::Tuned, TaskName::Trajectory),
        (Preset::Release, TaskName::Trajectory),
        (Preset::Tuned, TaskName::Reorientation),
        (Preset::Robust, TaskName::Trajectory),
        (Preset::Guided, TaskName::Trajectory),
        (Preset::Guided, TaskName::Capture),
        (Preset::Tuned, TaskName::Mixed),
    ] {
        let n = 42;
        let world = world(preset, task, n, 3);
        // Also with arms of six and of seven joints.
        let seven = include_str!("../../robots/seven-joints.toml");
        let seven = Robot::from_toml(seven, std::path::Path::new("seven-joints.toml"));
        let differing = World::new(&world.config, &seven.expect("valid"));
        let world = if preset == Preset::Robust { differing } else { world };
        let flat = parameters(&world.config, &world.dimensions, 8);
        let policy = world.policy(&flat).expect("a policy");
        let mut block = vec![0.0; world.block_layout().len];
        let spec = RolloutSpec { seed: 5, iteration: 2, shard: 0, policy: &policy };
        rollout(&world, &spec, &mut block, &mut |_| {}).expect("a block");
        let shared = Arc::new(world.clone());
        let of = |threads| Batch::new(Arc::clone(&shared), n, threads);
        let reference = replay(&world, &block, of(1), &InOrder);
        assert!(reference.iter().all(Memory::is_finite));
        assert!(reference == replay(&world, &block, of(64), &Apart), "in other chunks");
        for backend in [Backend::Avx2, Backend::Portable] {
            if backend.is_available() {
                let batch = Batch::on(backend, Arc::clone(&shared), n, 2);
                assert!(reference == replay(&world, &block, batch, &Apart), "{backend:?}");
            }
        }
    }
}

#[test]
fn environments_of_an_address_are_the_same_in_any_batch() {
    let world = Arc::new(world(Preset::Tuned, TaskName::Trajectory, 4, 2));
    let begin = |n: usize, begin: Begin| {
        let mut memory = Memory::new(n, &world.dimensions);
        let mut batch = Batch::new(Arc::clone(&world), n, 2);
        batch.reset(begin, &InOrder, memory.rows()).expect("episodes");
        memory
    };
    let many = begin(40, BEGIN);
    let few = begin(3, Begin { first: 20, ..BEGIN });
    for (many, few) in many.0.iter().zip(&few.0) {
        let width = few.len() / 3;
        assert_eq!(many[20 * width..23 * width], few[..]);
    }
    assert_ne!(many, begin(40, Begin { iteration: 3, ..BEGIN }));
    // Held-out goals are others, and every robot is at home: its joints are those of the first.
    let held_out = begin(40, Begin { goals: GoalKind::Evaluation, ..BEGIN });
    assert_ne!(held_out.0[7], many.0[7]);
    let robots: Vec<&[f32]> = held_out.0[9].chunks_exact(61).collect();
    assert!(robots.iter().all(|robot| *robot == robots[0]));
    assert!(many.0[9].chunks_exact(61).any(|robot| robot != robots[0]));
}

/// Robots of training may weigh other than described; those of evaluations never do.
#[test]
fn an_evaluation_after_a_training_is_that_of_a_new_batch() {
    let world = Arc::new(world(Preset::Robust, TaskName::Trajectory, 20, 3));
    let mut memory = Memory::new(20, &world.dimensions);
    let mut play = |batch: &mut Batch, goals| {
        batch.reset(Begin { goals, ..BEGIN }, &InOrder, memory.rows()).expect("episodes");
        let actions = vec![0.5; 20 * world.dimensions.n_agents * world.dimensions.n_actions];
        batch.step(&actions, &InOrder, memory.rows()).expect("a step");
        Memory(memory.0.clone())
    };
    let mut used = Batch::new(Arc::clone(&world), 20, 1);
    let training = play(&mut used, GoalKind::Training);
    let evaluation = play(&mut used, GoalKind::Evaluation);
    let mut new = Batch::new(Arc::clone(&world), 20, 1);
    assert_eq!(evaluation, play(&mut new, GoalKind::Evaluation));
    assert_ne!(evaluation, training);
}

/// Leaves the last task out.
struct GivesUp;

impl Executor for GivesUp {
    fn run(&self, n_tasks: usize, task: &(dyn Fn(usize) + Sync)) {
        (0..n_tasks - 1).for_each(task);
    }
}

#[test]
fn what_cannot_be_stepped_says_why_and_leaves_everything_as_it_was() {
    let world = Arc::new(world(Preset::Tuned, TaskName::Trajectory, 4, 2));
    let mut memory = Memory::new(3, &world.dimensions);
    let mut batch = Batch::new(Arc::clone(&world), 3, 1);
    let mut actions = vec![0.1; 3 * 24];
    let mut step = |batch: &mut Batch, actions: &[f32], executor: &dyn Executor| {
        let result = batch.step(actions, executor, memory.rows());
        result.map_err(|error| error.to_string())
    };
    assert!(step(&mut batch, &actions, &InOrder).expect_err("no episode").contains("reset first"));
    let mut shown = Memory::new(3, &world.dimensions);
    batch.reset(BEGIN, &InOrder, shown.rows()).expect("episodes");
    let error = step(&mut batch, &actions[1..], &InOrder).expect_err("too few");
    assert_eq!(error, "actions has 71 numbers, expected 72");
    actions[24 + 4] = f32::NAN;
    let error = step(&mut batch, &actions, &InOrder).expect_err("no number");
    assert_eq!(error, "environment 1, agent 1: action 1 is NaN, expected a finite number");
    assert_eq!(batch.steps(), Some(0), "nothing has changed");
    // Beyond all limits is clipped.
    actions[24 + 4] = f32::MAX;
    step(&mut batch, &actions, &InOrder).expect("a step");
    step(&mut batch, &actions, &InOrder).expect("a step");
    let error = step(&mut batch, &actions, &InOrder).expect_err("over");
    assert_eq!(error, "the episode is over after 2 steps: reset first");
    batch.reset(BEGIN, &InOrder, shown.rows()).expect("episodes");
    let error = step(&mut batch, &actions, &GivesUp).expect_err("given up");
    assert!(error.contains("left in its middle"), "{error}");
    assert_eq!(batch.steps(), None);
    assert!(step(&mut batch, &actions, &InOrder).expect_err("broken").contains("not finished"));
    let mut short = Memory::new(2, &world.dimensions);
    let error = batch.reset(BEGIN, &InOrder, short.rows()).expect_err("too short");
    assert!(error.to_string().contains("observation has"), "{error}");
    let error = batch
        .reset(Begin { first: u32::MAX - 1, ..BEGIN }, &InOrder, shown.rows())
        .expect_err("no address");
    assert!(error.to_string().contains("environment 4294967296"), "{error}");
}

#[test]
fn a_policy_acts_as_it_does_in_a_rollout() {
    let world = world(Preset::Tuned, TaskName::Trajectory, 70, 2);
    let flat = parameters(&world.config, &world.dimensions, 8);
    let policy = world.policy(&flat).expect("a policy");
    let mut block = vec![0.0; world.block_layout().len];
    let spec = RolloutSpec { seed: 5, iteration: 2, shard: 0, policy: &policy };
    rollout(&world, &spec, &mut block, &mut |_| {}).expect("a block");
    let mut memory = Memory::new(70, &world.dimensions);
    let mut batch = Batch::new(Arc::new(world.clone()), 70, 1);
    batch.reset(BEGIN, &InOrder, memory.rows()).expect("episodes");
    let mut actions = vec![0.0; 70 * 24];
    act(&world, &policy, (70, &memory.0[0]), &Apart, &mut actions).expect("actions");
    for env in 0..70 {
        for agent in 0..8 {
            let row = agent * 2 * 70 + env;
            let normals = proto::rng::Address {
                seed: 5,
                purpose: proto::rng::Purpose::ActionNoise,
                iteration: 2,
                env: env as u32,
                step: 0,
                index: agent as u32,
            }
            .normals();
            for u in 0..3 {
                // What the rollout did less its noise, in the rollout's own rounding.
                let mean = actions[(env * 8 + agent) * 3 + u];
                let explored = policy.std(agent)[u].mul_add(normals[u], mean);
                let at = world.block_layout().action.start + row * 3 + u;
                assert_eq!(explored, block[at], "environment {env}, agent {agent}");
            }
        }
    }
    memory.0[0][(3 * 8 + 2) * 48 + 5] = f32::NAN;
    let error = act(&world, &policy, (70, &memory.0[0]), &InOrder, &mut actions);
    let error = error.expect_err("no number").to_string();
    assert!(error.starts_with("environment 3, agent 2: observation 5 is NaN"), "{error}");
    let error = act(&world, &policy, (69, &memory.0[0]), &InOrder, &mut actions);
    assert!(error.expect_err("another size").to_string().contains("observations has"));
}
