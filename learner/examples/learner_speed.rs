//! Measures the update alone, on synthetic blocks: env-steps/s for the presets `paper` (bf16, f32)
//! and `tuned`.
//!
//! `cargo run --release -p learner --example learner_speed [-- SECONDS]`
#![expect(clippy::print_stdout, reason = "the figures are the program's output")]

use std::time::Instant;

use learner::mappo::Mappo;
use learner::precision::Arithmetic;
use learner::state::TrainingState;
use proto::config::{Layers, Preset, TaskName};
use proto::layout::Dimensions;
use tch::Device;

fn main() -> anyhow::Result<()> {
    let seconds: f64 = match std::env::args().nth(1) {
        Some(text) => text.parse()?,
        None => 20.0,
    };
    let cases = [
        (Preset::Tuned, Arithmetic::Bf16, None),
        (Preset::Tuned, Arithmetic::F32, None),
        (Preset::Tuned, Arithmetic::Bf16, Some("network.hidden=[128,128]")),
        (Preset::Paper, Arithmetic::Bf16, None),
        (Preset::Paper, Arithmetic::F32, None),
    ];
    for (preset, arithmetic, change) in cases {
        let mut layers = Layers::new(preset, Some(TaskName::Trajectory));
        if let Some(change) = change {
            layers = layers.set(change)?;
        }
        let config = layers.resolve()?;
        let dimensions = Dimensions::new(&config, 4);
        let blocks = learner::synthetic::blocks(&dimensions, 7);
        let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
        let mut state = TrainingState::initial(&config, &dimensions, arithmetic, Device::Cpu);
        let mut mappo = Mappo::new(&config, &dimensions, &state);
        mappo.update(&mut state, &shards)?;
        let start = Instant::now();
        let mut best = f64::INFINITY;
        let mut updates = 0;
        while updates < 2 || start.elapsed().as_secs_f64() < seconds {
            let begun = Instant::now();
            mappo.update(&mut state, &shards)?;
            best = best.min(begun.elapsed().as_secs_f64());
            updates += 1;
        }
        let steps = config.steps_per_iteration() as f64;
        let mean = start.elapsed().as_secs_f64() / f64::from(updates);
        println!(
            "{} {} {:?}: {:.0} env-steps/s (best of {updates}: {:.0})",
            preset.as_str(),
            arithmetic.as_str(),
            config.network.hidden,
            steps / mean,
            steps / best,
        );
    }
    Ok(())
}
