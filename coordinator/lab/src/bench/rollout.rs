//! Simulation with a policy: what a worker does, in one thread of this process.

use std::time::{Duration, Instant};

use process::clock::thread_cpu;
use proto::config::{Config, Inference};
use proto::layout::{Dimensions, EpisodeMetrics};
use simulator::env::step_options;
use simulator::policy::initial_parameters;
use simulator::random_motion::operations_per_step;
use simulator::robot::Robot;
use simulator::rollout::Stage;
use simulator::rollout::{RolloutSpec, World, rollout};

use super::arithmetic;
use super::context::Bench;
use super::figures::{Figure, Figures};
use super::peer::Peers;
use super::processor::Processor;

/// Hidden layers that are always measured beside those of the configuration.
pub(super) const OTHERS: [(&str, &str); 2] =
    [("2x256", "network.hidden=[256,256]"), ("2x128", "network.hidden=[128,128]")];

/// Figures `rollout.*`.
pub(super) fn measure(
    bench: &Bench,
    peers: Option<&Peers>,
    figures: &mut Figures,
) -> anyhow::Result<()> {
    bench.begin("rollout")?;
    let rates = rates(bench, &bench.config, &bench.robot, bench.seconds)?;
    let peer = match peers {
        None => None,
        Some(peers) => {
            let torch = peers.torch(bench)?;
            let mujoco = peers.known_mujoco(bench)?;
            let threads = bench.config.run.learner_threads as f64;
            Some(1.0 / (1.0 / mujoco + threads / torch.inference))
        }
    };
    let physics = operations_per_step(&bench.robot, &step_options(&bench.config));
    let (single, pairs) = policy_flops(&bench.config, &bench.dimensions);
    let peak = arithmetic::peak(bench.seconds / 10.0);
    let pair_peak = arithmetic::pair_peak(bench.seconds / 10.0);
    // Pairs can be multiplied as two numbers, too.
    let floor = 1.0 / ((physics + single) / peak + pairs / pair_peak.max(peak));
    let unit = "env-steps/s";
    let figure = Figure::rate("rollout.env_steps_per_s_per_core", unit, rates.env_steps_per_s);
    figures.push(figure.peer(peer).floor(Some(floor)));
    let core = Processor::here();
    for (name, peak, limit) in
        [("core", peak, core.peak(false)), ("pair", pair_peak, core.pair_peak())]
    {
        let key = format!("rollout.{name}_gflop_per_s");
        figures.push(Figure::rate(key, "GFLOP/s", 1e-9 * peak).limit(Some(1e-9 * limit)));
    }
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

impl Rates {
    /// Per second of processor time, without networks and sampling.
    pub(super) fn without_policy(&self) -> f64 {
        1e6 / (self.physics_us + self.observe_us)
    }
}

/// Rolls shards out for `seconds`, one at least.
pub(super) fn rates(
    bench: &Bench,
    config: &Config,
    robot: &Robot,
    seconds: f64,
) -> anyhow::Result<Rates> {
    let world = World::new(config, robot);
    let policy = world.policy(&initial_parameters(config, &world.dimensions, 1))?;
    let mut block = vec![0.0; world.block_layout().len];
    let (mut steps, mut shard) = (0, 0);
    let (mut physics, mut inference, mut observe) =
        (Duration::ZERO, Duration::ZERO, Duration::ZERO);
    let (start, cpu) = (Instant::now(), thread_cpu());
    let mut last = start;
    let mut on_stage = |stage| {
        let now = Instant::now();
        let part = match stage {
            Stage::Observed => &mut observe,
            Stage::Decided => &mut inference,
            Stage::Moved => &mut physics,
        };
        *part += now - last;
        last = now;
    };
    while steps == 0 || start.elapsed().as_secs_f64() < seconds {
        bench.go_on()?;
        let spec = RolloutSpec { seed: config.run.seed, iteration: 0, shard, policy: &policy };
        rollout(&world, &spec, &mut block, &mut on_stage)?;
        steps += world.block_env_steps();
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
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};

    use super::*;

    #[test]
    fn products_of_the_policy_by_hand() {
        let config = Layers::new(Preset::Paper, None).resolve().expect("valid");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        // 28·512 + 512·512 + 512·3 weights, two operations each, eight agents.
        let (single, pairs) = policy_flops(&config, &dimensions);
        assert_eq!((single, pairs), (16.0 * 15_872.0, 16.0 * 262_144.0));
    }
}
