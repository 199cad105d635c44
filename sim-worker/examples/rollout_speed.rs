//! Prints env-steps per second of one core and where the time goes, for the networks of the presets.
//!
//! ```sh
//! cargo run --release -p sim-worker --example rollout_speed
//! ```

use std::time::{Duration, Instant};

use proto::config::{Layers, Preset};
use proto::layout::ActorLayout;
use sim_worker::robot::Robot;
use sim_worker::rollout::{RolloutSpec, World, rollout};
use sim_worker::scalar::Backend;

/// How long to measure each case.
const MEASURE: Duration = Duration::from_secs(4);

/// Time that this thread has run, not counting what others had of its core.
fn cpu_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(Duration::from_nanos(text.split_whitespace().next()?.parse().ok()?))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    eprintln!("back end {:?}, one thread", Backend::detect());
    for (preset, name, hidden) in [
        (Preset::Tuned, "tuned, 2 × 256", vec![256, 256]),
        (Preset::Paper, "paper, 2 × 512", vec![512, 512]),
    ] {
        let mut config = Layers::new(preset, None).resolve()?;
        config.network.hidden = hidden;
        let robot = Robot::builtin(&config.robot.description).ok_or("no such robot")?;
        let world = World::new(&config, &robot);
        // Any weights will do, as long as actions stay of size one.
        let length = ActorLayout::new(&config, &world.dimensions).len;
        let parameters: Vec<f32> =
            (0..length).map(|i| ((i * 7919) % 1000) as f32 * 2e-4 - 0.1).collect();
        let start = Instant::now();
        let policy = world.policy(&parameters)?;
        let packed = start.elapsed();
        let mut block = vec![0.0; world.block_layout().len];
        let (mut steps, mut physics, mut inference, mut observe) =
            (0, Duration::ZERO, Duration::ZERO, Duration::ZERO);
        let mut shard = 0;
        let (start, cpu_start) = (Instant::now(), cpu_time());
        while start.elapsed() < MEASURE {
            let spec = RolloutSpec { seed: 1, iteration: 0, shard, policy: &policy };
            let stats = rollout(&world, &spec, &mut block, &mut || {})?;
            steps += stats.env_steps;
            physics += stats.timing.physics;
            inference += stats.timing.policy;
            observe += stats.timing.observe;
            shard = (shard + 1) % world.dimensions.n_shards as u32;
        }
        let wall = start.elapsed();
        let cpu = cpu_start.zip(cpu_time()).map_or(wall, |(start, end)| end.saturating_sub(start));
        // On a busy machine the wall clock also counts the others' turns.
        let busy = cpu.as_secs_f64() / wall.as_secs_f64();
        let share = |time: Duration| time.as_secs_f64() * busy / steps as f64 * 1e6;
        eprintln!(
            "{name}: {:.0} env-steps per second of a core, shards of {}; µs per env-step: physics {:.1}, \
             policy {:.1}, observation and writing {:.1}; packing a policy takes {:.1} ms",
            steps as f64 / cpu.as_secs_f64(),
            world.dimensions.n_envs,
            share(physics),
            share(inference),
            share(observe),
            packed.as_secs_f64() * 1e3,
        );
    }
    Ok(())
}
