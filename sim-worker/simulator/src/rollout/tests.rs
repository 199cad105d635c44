use proto::config::{Layers, ParameterSharing, Preset, TaskName};
use proto::layout::{AGENTS_PER_ARM, ActorLayout, Dimensions, EpisodeMetrics};
use proto::rng::Purpose;

use super::*;
use crate::policy::tests::{parameters, plain_mean};
use crate::robot::Robot;
use crate::scalar::Backend;

/// A world of `n_envs` environments in `n_shards` shards, `steps` steps, small networks.
fn world(preset: Preset, task: TaskName, n_envs: usize, n_shards: usize, steps: usize) -> World {
    world_of(&Layers::new(preset, Some(task)), n_envs, n_shards, steps)
}

/// Likewise for any configuration.
fn world_of(layers: &Layers, n_envs: usize, n_shards: usize, steps: usize) -> World {
    let mut config = layers.resolve().expect("valid");
    config.env.n_envs = n_envs;
    config.env.n_shards = n_shards;
    config.task.episode_steps = steps;
    config.network.hidden = vec![24, 17];
    config.algorithm.mini_batches = 1;
    config.validate().expect("valid");
    let robot = Robot::builtin(&config.robot.description).expect("built in");
    World::new(&config, &robot)
}

/// The same on a robot with arms of six and of seven joints.
fn on_seven_joints(world: &World) -> World {
    let text = include_str!("../../robots/seven-joints.toml");
    let robot = Robot::from_toml(text, std::path::Path::new("seven-joints.toml")).expect("valid");
    World::new(&world.config, &robot)
}

/// Parameters; where agents of a role are one actor, the last one is another, so that not all networks have as many actors.
fn flat(world: &World) -> Vec<f32> {
    let World { config, dimensions, .. } = world;
    let mut flat = parameters(config, dimensions, 11);
    if config.network.parameter_sharing == ParameterSharing::Roles {
        for tensor in &ActorLayout::new(config, dimensions).tensors {
            let row = tensor.len() / dimensions.n_actors;
            let rows = &mut flat[tensor.range()];
            for actor in AGENTS_PER_ARM..dimensions.n_actors - 1 {
                let of_role = actor % AGENTS_PER_ARM * row;
                rows.copy_within(of_role..of_role + row, actor * row);
            }
        }
    }
    flat
}

/// The block of one shard; memory starts as garbage, which must not show.
fn block(world: &World, iteration: u64, shard: u32) -> Vec<f32> {
    let policy = world.policy(&flat(world)).expect("a policy");
    let mut block = vec![f32::from_bits(0x7fc0_1234); world.block_layout().len];
    let spec = RolloutSpec { seed: 5, iteration, shard, policy: &policy };
    let mut steps = 0;
    let mut count = |stage| steps += usize::from(stage == Stage::Moved);
    rollout(world, &spec, &mut block, &mut count).expect("a block");
    assert_eq!(world.block_env_steps(), (world.dimensions.n_envs * steps) as u64);
    assert_eq!(steps, world.dimensions.n_steps);
    block
}

/// Everything that `block` says about its local environment `n`, in a fixed order, as bits.
fn rows(world: &World, block: &[f32], n: usize) -> Vec<u32> {
    let Dimensions { n_agents, n_steps, n_envs, observation, state, n_metrics, .. } =
        world.dimensions;
    let layout = world.block_layout();
    let mut bits = Vec::new();
    // Each array is [outer, N, inner].
    for (range, outer, inner) in [
        (&layout.observation, n_agents * (n_steps + 1), observation),
        (&layout.state, n_steps + 1, state),
        (&layout.action, n_agents * n_steps, world.dimensions.n_actions),
        (&layout.log_prob, n_agents * n_steps, 1),
        (&layout.reward, n_agents * n_steps, 1),
        (&layout.terminated, n_steps, 1),
        (&layout.truncated, n_steps, 1),
        (&layout.metrics, 1, n_metrics),
    ] {
        let array = &block[range.clone()];
        assert_eq!(array.len(), outer * n_envs * inner);
        for i in 0..outer {
            let at = (i * n_envs + n) * inner;
            bits.extend(array[at..at + inner].iter().map(|x| x.to_bits()));
        }
    }
    bits
}

#[test]
fn an_environments_rows_do_not_depend_on_the_sharding() {
    for (preset, task) in [
        (Preset::Tuned, TaskName::Trajectory),
        (Preset::Release, TaskName::Reorientation),
        (Preset::Robust, TaskName::Trajectory),
        (Preset::Guided, TaskName::Trajectory),
    ] {
        // 42 environments: groups of 16, 16 and 10; of 14; of 6; alone.
        let whole = world(preset, task, 42, 1, 3);
        let differing = preset == Preset::Guided;
        let whole = if differing { on_seven_joints(&whole) } else { whole };
        let reference = block(&whole, 2, 0);
        assert!(reference.iter().all(|x| x.is_finite()), "everything is written");
        for n_shards in [3, 7, 42] {
            let split = world(preset, task, 42, n_shards, 3);
            let split = if differing { on_seven_joints(&split) } else { split };
            let n = split.dimensions.n_envs;
            for shard in 0..n_shards as u32 {
                let part = block(&split, 2, shard);
                for env in 0..n {
                    let global = shard as usize * n + env;
                    assert!(
                        rows(&split, &part, env) == rows(&whole, &reference, global),
                        "environment {global} differs in {n_shards} shards"
                    );
                }
            }
        }
        assert!(reference == block(&whole, 2, 0), "the same order gives the same block");
        assert!(reference != block(&whole, 3, 0), "another iteration draws anew");
    }
}

#[test]
fn every_back_end_makes_the_same_block() {
    for preset in [Preset::Paper, Preset::Robust, Preset::Guided] {
        every_back_end_makes_the_same_block_with(preset);
    }
}

fn every_back_end_makes_the_same_block_with(preset: Preset) {
    let world = world(preset, TaskName::Trajectory, 18, 1, 3);
    let policy = world.policy(&flat(&world)).expect("a policy");
    let spec = RolloutSpec { seed: 5, iteration: 0, shard: 0, policy: &policy };
    let on = |backend| {
        let mut block = vec![0.0; world.block_layout().len];
        rollout_on(backend, &world, &spec, &mut block, &mut |_| {}).expect("a block");
        block
    };
    let reference = on(Backend::detect());
    for backend in [Backend::Avx2, Backend::Portable] {
        if backend.is_available() {
            assert!(on(backend) == reference, "{backend:?}");
        }
    }
}

#[test]
fn single_precision_lanes_follow_the_f64_twin() {
    for (preset, task) in
        [(Preset::Release, TaskName::Trajectory), (Preset::Tuned, TaskName::Reorientation)]
    {
        let world = world(preset, task, 5, 1, 5);
        let policy = world.policy(&flat(&world)).expect("a policy");
        let spec = RolloutSpec { seed: 5, iteration: 0, shard: 0, policy: &policy };
        let lanes = block(&world, 0, 0);
        let mut twin = vec![0.0; world.block_layout().len];
        rollout_with::<f64>(&world, &spec, &mut twin).expect("a block");
        // Single precision carries 6e-8 relative per operation; 27 substeps of about a thousand
        // operations each add like a random walk, 164 × 6e-8 = 1e-5 a step, on numbers up to 6
        // (rates up to 2.5 rad/s). Rewards magnify: d log10(e²)/de = 0.87/e ≤ 9 for e ≥ 0.1.
        let layout = world.block_layout();
        for (range, tolerance) in [
            (&layout.observation, 1e-3),
            (&layout.state, 1e-3),
            (&layout.action, 1e-3),
            (&layout.log_prob, 1e-4),
            (&layout.reward, 1e-2),
            (&layout.metrics, 1e-3),
        ] {
            for i in range.clone() {
                let error = (lanes[i] - twin[i]).abs();
                assert!(
                    error < tolerance * lanes[i].abs().max(1.0),
                    "{preset:?}: element {} of {range:?}: {} vs {}",
                    i - range.start,
                    lanes[i],
                    twin[i]
                );
            }
        }
    }
}

#[test]
fn actions_and_log_probabilities_follow_from_the_observations() {
    for algorithm in ["mappo", "ppo"] {
        let layers = Layers::new(Preset::Tuned, None);
        let layers = layers.set(&format!("algorithm.name={algorithm}")).expect("well formed");
        let world = world_of(&layers, 3, 1, 4);
        check_actions(&world);
        check_actions(&on_seven_joints(&world));
    }
}

fn check_actions(world: &World) {
    let flat = flat(world);
    let policy = world.policy(&flat).expect("a policy");
    let block = block(world, 7, 0);
    let layout = world.block_layout();
    let Dimensions { joints, n_agents, n_steps, n_envs, n_actions, observation: o, .. } =
        world.dimensions;
    let (mut close, mut all) = (0, 0);
    for agent in 0..n_agents {
        for step in 0..n_steps {
            for env in 0..n_envs {
                // What the agent's actor sees: the observations of all of its agents.
                let per_actor = world.dimensions.agents_per_actor();
                let actor = agent / per_actor;
                let seen: Vec<f64> = (actor * per_actor..(actor + 1) * per_actor)
                    .flat_map(|agent| {
                        let row = (agent * (n_steps + 1) + step) * n_envs + env;
                        &block[layout.observation.start + row * o..][..o]
                    })
                    .map(|&x| f64::from(x))
                    .collect();
                let means = plain_mean(&world.config, &world.dimensions, &flat, actor, &seen);
                let mean = &means[agent % per_actor * n_actions..];
                let normals = proto::rng::Address {
                    seed: 5,
                    purpose: Purpose::ActionNoise,
                    iteration: 7,
                    env: env as u32,
                    step: step as u32,
                    index: agent as u32,
                }
                .normals();
                let row = (agent * n_steps + step) * n_envs + env;
                let mut log_prob = 0.0;
                let actions = &block[layout.action.start + row * n_actions..][..n_actions];
                let own = joints.of_agent(agent).len();
                assert!(actions[own..].iter().all(|&x| x == 0.0), "without a joint");
                for u in 0..own {
                    let std = f64::from(policy.log_std(agent)[u]).exp();
                    let by_hand = mean[u] + std * f64::from(normals[u]);
                    let action = f64::from(actions[u]);
                    // Sums of tens of products in single precision; where an activation rounds to
                    // the other bfloat16, 2⁻⁸ of it.
                    let error = (action - by_hand).abs();
                    assert!(error < 5e-3, "{action} vs {by_hand}");
                    close += usize::from(error < 1e-5);
                    all += 1;
                    log_prob -= 0.5 * f64::from(normals[u]).powi(2)
                        + std.ln()
                        + 0.5 * std::f64::consts::TAU.ln();
                }
                let found = f64::from(block[layout.log_prob.start + row]);
                // z is recovered from the rounded action: 1e-7 · |a|/σ, times |z| ≤ 5.
                assert!((found - log_prob).abs() < 1e-5, "{found} vs {log_prob}");
            }
        }
    }
    assert!(close * 100 >= all * 80, "{close} of {all} actions");
}

/// What is uniform and what is the actor's own, and by how much it is off, follows from addresses alone.
#[test]
fn deterministic_actors_explore_as_they_are_scheduled() {
    let layers = [
        "algorithm.name=maddpg",
        "algorithm.maddpg.action_limit=2.5",
        "algorithm.maddpg.noise=0.9",
        "algorithm.maddpg.noise_final=0.5",
        "algorithm.maddpg.random=0.25",
        "algorithm.maddpg.random_final=0.45",
        "algorithm.maddpg.noise_steps=240",
    ]
    .into_iter()
    .fold(Layers::new(Preset::Tuned, None), |layers, a| layers.set(a).expect("well formed"));
    let world = world_of(&layers, 3, 1, 8);
    check_exploration(&world);
    check_exploration(&on_seven_joints(&world));
}

fn check_exploration(world: &World) {
    let flat = flat(world);
    let layout = world.block_layout();
    let Dimensions { joints, n_agents, n_steps, n_envs, n_actions, observation: o, .. } =
        world.dimensions;
    // Halfway: 5 iterations of 24 steps. Then at the end.
    for (iteration, std, random) in [(5, 2.5 * 0.7, 0.35), (20, 2.5 * 0.5, 0.45)] {
        let block = block(world, iteration, 0);
        assert!(block[layout.log_prob.clone()].iter().all(|&x| x == 0.0));
        let (mut uniform, mut clipped, mut close, mut all) = (0, 0, 0, 0);
        for (agent, step, env) in (0..n_agents)
            .flat_map(|a| (0..n_steps).flat_map(move |t| (0..n_envs).map(move |n| (a, t, n))))
        {
            let row = (agent * (n_steps + 1) + step) * n_envs + env;
            let seen = &block[layout.observation.start + row * o..][..o];
            let seen: Vec<f64> = seen.iter().map(|&x| f64::from(x)).collect();
            let output = plain_mean(&world.config, &world.dimensions, &flat, agent, &seen);
            let address = |purpose, index| proto::rng::Address {
                seed: 5,
                purpose,
                iteration: iteration as u32,
                env: env as u32,
                step: step as u32,
                index,
            };
            let index = agent as u32;
            let normals = address(Purpose::ActionNoise, index).normals();
            let uniforms = [index, index + 65_536]
                .map(|index| address(Purpose::RandomAction, index).uniforms().map(f64::from))
                .concat();
            let row = (agent * n_steps + step) * n_envs + env;
            let actions = &block[layout.action.start + row * n_actions..][..n_actions];
            let own = joints.of_agent(agent).len();
            assert!(actions[own..].iter().all(|&x| x == 0.0), "without a joint");
            for u in 0..own {
                let expected = if uniforms[0] < random {
                    uniform += 1;
                    5.0 * uniforms[u + 1] - 2.5
                } else {
                    output[u] + std * f64::from(normals[u])
                };
                clipped += usize::from(expected.abs() > 2.5);
                let action = f64::from(actions[u]);
                let error = (action - expected.clamp(-2.5, 2.5)).abs();
                // As for stochastic actors, times the limit.
                assert!(error < 1.3e-2, "{action} vs {expected}");
                close += usize::from(error < 3e-5);
                all += 1;
            }
        }
        assert!(close * 100 >= all * 90, "{close} of {all} actions");
        let share = f64::from(uniform) / all as f64;
        // 192 draws of an agent: five standard errors.
        assert!((share - random).abs() < 0.18, "{share} of the actions are uniform");
        assert!(clipped > 0, "the limit is tested");
    }
}

#[test]
fn episodes_are_truncated_at_their_end_and_never_terminated() {
    let world = world(Preset::Tuned, TaskName::Trajectory, 20, 1, 4);
    let block = block(&world, 0, 0);
    let layout = world.block_layout();
    assert!(block[layout.terminated.clone()].iter().all(|&x| x == 0.0));
    let truncated = &block[layout.truncated.clone()];
    assert!(truncated[..60].iter().all(|&x| x == 0.0));
    assert!(truncated[60..].iter().all(|&x| x == 1.0));
}

#[test]
fn metrics_are_those_of_the_poses_in_the_observations() {
    let world = world(Preset::Release, TaskName::Trajectory, 17, 1, 4);
    let block = block(&world, 0, 0);
    let layout = world.block_layout();
    let Dimensions { n_steps, n_envs, observation: o, n_metrics, .. } = world.dimensions;
    let places = EpisodeMetrics::new(4);
    for env in 0..n_envs {
        for arm in 0..4 {
            // The arm's first agent sees its hand's position at 19…21, its second the attitude; both see
            // the goal at 25…30.
            let error = |step: usize, part: usize| {
                let at = layout.observation.start
                    + (((2 * arm + part) * (n_steps + 1) + step) * n_envs + env) * o;
                let seen = &block[at..at + o];
                let (is, goal) = (&seen[19..22], &seen[25 + 3 * part..]);
                is.iter().zip(goal).map(|(is, goal)| (goal - is).powi(2)).sum::<f32>().sqrt()
            };
            let metrics = &block[layout.metrics.start + env * n_metrics..][..n_metrics];
            for (part, last, min) in [
                (0, &places.final_position, &places.min_position),
                (1, &places.final_orientation, &places.min_orientation),
            ] {
                let smallest = (1..=n_steps).map(|t| error(t, part)).fold(f32::MAX, f32::min);
                // The norm's three roundings in another order.
                assert!((metrics[last.start + arm] - error(n_steps, part)).abs() < 1e-6);
                assert!((metrics[min.start + arm] - smallest).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn orders_that_do_not_fit_are_refused() {
    let world = world(Preset::Tuned, TaskName::Trajectory, 4, 2, 2);
    let policy = world.policy(&flat(&world)).expect("a policy");
    let mut block = vec![0.0; world.block_layout().len];
    let spec = RolloutSpec { seed: 5, iteration: 0, shard: 2, policy: &policy };
    let error = rollout(&world, &spec, &mut block, &mut |_| {}).expect_err("no such shard");
    assert!(error.to_string().contains("shard 2"), "{error}");
    let spec = RolloutSpec { shard: 1, ..spec };
    let error = rollout(&world, &spec, &mut block[1..], &mut |_| {}).expect_err("too short");
    assert!(matches!(error, RolloutError::BlockLength { .. }), "{error}");
}

#[test]
fn a_diverged_policy_is_caught_in_the_step_that_shows_it() {
    let world = world(Preset::Paper, TaskName::Trajectory, 40, 2, 3);
    let mut flat = flat(&world);
    // Finite parameters whose sums are not: LayerNorm then takes ∞ − ∞ in agent 6's second layer.
    let layout = proto::layout::ActorLayout::new(&world.config, &world.dimensions);
    let weights = layout.get("hidden.1.weight").expect("exists");
    let length = weights.len() / 8;
    flat[weights.offset + 6 * length..][..length].fill(3e38);
    // A large shift below makes every sum positive, so that no ReLU hides it.
    let shift = layout.get("hidden.0.shift").expect("exists");
    let length = shift.len() / 8;
    flat[shift.offset + 6 * length..][..length].fill(100.0);
    let policy = world.policy(&flat).expect("finite parameters");
    let mut block = vec![0.0; world.block_layout().len];
    let spec = RolloutSpec { seed: 5, iteration: 4, shard: 1, policy: &policy };
    let error = rollout(&world, &spec, &mut block, &mut |_| {}).expect_err("diverged").to_string();
    assert!(
        error.contains("iteration 4, shard 1: environment 20, step 0, agent 6: the mean of action"),
        "{error}"
    );
}
