//! Simulation with a policy: what a worker does, in one thread of this process.

use std::time::{Duration, Instant};

use proto::clock::thread_cpu;
use proto::config::{Config, Inference};
use proto::layout::{ActorLayout, Dimensions, EpisodeMetrics, JOINTS_PER_AGENT};
use proto::rng::{Address, Purpose};
use sim_worker::env::step_options;
use sim_worker::robot::Robot;
use sim_worker::rollout::{RolloutSpec, World, rollout};

use super::figures::{Figure, Figures};
use super::{Bench, arithmetic};

/// Hidden layers that are always measured beside those of the configuration.
pub(super) const OTHERS: [(&str, &str); 2] =
    [("2x256", "network.hidden=[256,256]"), ("2x128", "network.hidden=[128,128]")];

/// Figures `rollout.*`.
pub(super) fn measure(bench: &Bench, figures: &mut Figures) -> anyhow::Result<()> {
    bench.begin("rollout")?;
    let rates = rates(bench, &bench.config, &bench.robot, bench.seconds)?;
    let peer = match &bench.peers {
        None => None,
        Some(peers) => {
            let torch = peers.torch(bench)?;
            let mujoco = peers.known_mujoco(bench)?;
            let threads = bench.config.run.learner_threads as f64;
            Some(1.0 / (1.0 / mujoco + threads / torch.inference))
        }
    };
    let physics = arithmetic::physics(&bench.robot, &step_options(&bench.config));
    let (single, pairs) = policy_flops(&bench.config, &bench.dimensions);
    let floor = 1.0
        / ((physics + single) / arithmetic::peak(bench.seconds / 10.0)
            + pairs / arithmetic::pair_peak(bench.seconds / 10.0));
    let unit = "env-steps/s";
    let figure = Figure::rate("rollout.env_steps_per_s_per_core", unit, rates.env_steps_per_s);
    figures.push(figure.peer(peer).floor(Some(floor)));
    for (part, microseconds) in
        [("physics", rates.physics_us), ("policy", rates.policy_us), ("observe", rates.observe_us)]
    {
        figures.push(Figure::cost(format!("rollout.{part}_us"), "µs/env-step", microseconds));
    }
    figures.push(Figure::cost("rollout.touching_pairs", "pairs", rates.touching_pairs));
    for (name, change) in OTHERS {
        bench.begin(&format!("rollout {name}"))?;
        let config = bench.config_with(&[change])?;
        let rate = self::rates(bench, &config, &bench.robot, bench.seconds)?.env_steps_per_s;
        figures.push(Figure::rate(format!("rollout.{name}.env_steps_per_s_per_core"), unit, rate));
    }
    Ok(())
}

/// How fast one thread is, and where its time goes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rates {
    /// Per second of processor time.
    pub(super) env_steps_per_s: f64,
    physics_us: f64,
    policy_us: f64,
    observe_us: f64,
    /// Mean over the last block: exploration touches more than the commands of `physics` do.
    touching_pairs: f64,
}

/// Rolls shards out for `seconds`, one at least.
pub(super) fn rates(
    bench: &Bench,
    config: &Config,
    robot: &Robot,
    seconds: f64,
) -> anyhow::Result<Rates> {
    let world = World::new(config, robot);
    let policy = world.policy(&initial_policy(config, &world.dimensions))?;
    let mut block = vec![0.0; world.block_layout().len];
    let (mut steps, mut shard) = (0, 0);
    let (mut physics, mut inference, mut observe) =
        (Duration::ZERO, Duration::ZERO, Duration::ZERO);
    let (start, cpu) = (Instant::now(), thread_cpu());
    while steps == 0 || start.elapsed().as_secs_f64() < seconds {
        bench.go_on()?;
        let spec = RolloutSpec { seed: config.run.seed, iteration: 0, shard, policy: &policy };
        let stats = rollout(&world, &spec, &mut block, &mut || {})?;
        steps += stats.env_steps;
        physics += stats.timing.physics;
        inference += stats.timing.policy;
        observe += stats.timing.observe;
        shard = (shard + 1) % world.dimensions.n_shards as u32;
    }
    let sizes = &world.dimensions;
    let pairs = EpisodeMetrics::new(sizes.n_arms).contact_pairs;
    let metrics = &block[world.block_layout().metrics.clone()];
    let touching: f32 = metrics.chunks_exact(sizes.n_metrics).map(|row| row[pairs]).sum();
    let (wall, cpu) = (start.elapsed().as_secs_f64(), thread_cpu() - cpu);
    // The rollout's own clock is the wall's, which on a busy machine also counts others' turns.
    let share = |time: Duration| time.as_secs_f64() * cpu / wall / steps as f64 * 1e6;
    Ok(Rates {
        env_steps_per_s: steps as f64 / cpu,
        physics_us: share(physics),
        policy_us: share(inference),
        observe_us: share(observe),
        touching_pairs: f64::from(touching) / (sizes.n_envs * sizes.n_steps) as f64,
    })
}

/// Actors like those that a training begins with: weights of the learner's scale, normal instead of
/// orthogonal, so that actions are of the same size.
fn initial_policy(config: &Config, dimensions: &Dimensions) -> Vec<f32> {
    let layout = ActorLayout::new(config, dimensions);
    let mut parameters = vec![0.0; layout.len];
    for (index, tensor) in layout.tensors.iter().enumerate() {
        let fan_in = tensor.shape[1] as f64;
        let part = &mut parameters[tensor.range()];
        let name = tensor.name.as_str();
        match (name, name.rsplit('.').next().unwrap_or_default()) {
            ("head.weight", _) => fill(part, index, config.network.head_gain / fan_in.sqrt()),
            ("log_std", _) => {
                for (agent, joints) in part.chunks_exact_mut(JOINTS_PER_AGENT).enumerate() {
                    joints.fill(config.network.initial_log_std_of(agent) as f32);
                }
            }
            (_, "weight") => fill(part, index, (2.0 / fan_in).sqrt()),
            (_, "gain" | "inverse_std") => part.fill(1.0),
            _ => {}
        }
    }
    parameters
}

/// Normal numbers of a deviation.
fn fill(part: &mut [f32], tensor: usize, deviation: f64) {
    let purpose = Purpose::Initialisation;
    for (step, four) in part.chunks_mut(4).enumerate() {
        let (iteration, step) = (tensor as u32, step as u32);
        let address = Address { seed: 1, purpose, iteration, env: 0, step, index: 0 };
        four.iter_mut().zip(address.normals()).for_each(|(x, z)| *x = z * deviation as f32);
    }
}

/// Operations of all actors' matrix products for an env-step: those in `f32`, and those of bfloat16.
fn policy_flops(config: &Config, dimensions: &Dimensions) -> (f64, f64) {
    let widths: Vec<usize> = std::iter::once(dimensions.actor_input())
        .chain(config.network.hidden.iter().copied())
        .chain(std::iter::once(dimensions.actor_output()))
        .collect();
    let layers: Vec<usize> = widths.windows(2).map(|pair| pair[0] * pair[1]).collect();
    let all: usize = layers.iter().sum();
    let pairs: usize = match config.network.inference {
        Inference::F32 => 0,
        // All but the first layer and the head.
        Inference::Bf16 => layers[1..layers.len() - 1].iter().sum(),
    };
    let flops = |weights| (2 * dimensions.n_actors * weights) as f64;
    (flops(all - pairs), flops(pairs))
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;

    #[test]
    fn actors_are_of_the_scale_that_training_begins_with() {
        let config = Layers::new(Preset::Paper, None).resolve().expect("valid");
        let dimensions = Dimensions::new(&config, 4);
        let parameters = initial_policy(&config, &dimensions);
        let layout = ActorLayout::new(&config, &dimensions);
        let square = |name: &str| {
            let part = &parameters[layout.get(name).expect("exists").range()];
            part.iter().map(|x| f64::from(x * x)).sum::<f64>() / part.len() as f64
        };
        // 8·512·512 and 8·512·3 numbers: means of squares are right to 0.1 % and 1.3 %, times five.
        assert!((square("hidden.1.weight") * 256.0 - 1.0).abs() < 0.005);
        assert!((square("head.weight") * 512.0 * 1e4 - 1.0).abs() < 0.065);
        assert_eq!(square("input.gain"), 1.0);
        assert_eq!(square("hidden.0.bias") + square("log_std"), 0.0);
        // 28·512 + 512·512 + 512·3 weights, two operations each, eight agents.
        let (single, pairs) = policy_flops(&config, &dimensions);
        assert_eq!((single, pairs), (16.0 * 15_872.0, 16.0 * 262_144.0));
    }
}
