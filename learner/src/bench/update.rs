//! The update alone, on synthetic blocks.

use std::time::Instant;

use proto::layout::Dimensions;
use proto::{ExitError, config::Config};
use serde_json::{Value, json};
use tch::Device;

use super::{Common, flops, product};
use crate::algorithm::Algorithm;
use crate::learner::device;
use crate::precision::Arithmetic;
use crate::state::TrainingState;
use crate::{LearnerError, synthetic};

/// Options of `learner bench update`.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    common: Common,
    /// Also how fast libtorch multiplies matrices of these sizes.
    #[arg(long)]
    product: bool,
}

/// Env-steps/s, with what is needed to judge them.
pub(super) fn measure(arguments: &Arguments) -> Result<Value, ExitError> {
    let (config, dimensions) = arguments.common.begin()?;
    let device = device(&config.run.device)?;
    tch::set_num_threads(i32::try_from(config.run.learner_threads).unwrap_or(i32::MAX));
    tch::set_num_interop_threads(1);
    let seconds = arguments.common.seconds;
    let mut figures = updates(&config, &dimensions, device, seconds)?;
    if arguments.product {
        let arithmetic = Arithmetic::of(config.run.precision)?;
        let rate = product::best_rate(&config, &dimensions, arithmetic.kind(), device, seconds);
        figures["product_gflop_per_s"] = json!(rate);
    }
    Ok(figures)
}

fn updates(
    config: &Config,
    dimensions: &Dimensions,
    device: Device,
    seconds: f64,
) -> Result<Value, LearnerError> {
    let arithmetic = Arithmetic::of(config.run.precision)?;
    let blocks = synthetic::explored_blocks(&config.network, dimensions, config.run.seed);
    let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
    let mut state = TrainingState::initial(config, dimensions, arithmetic, device);
    let mut algorithm = Algorithm::new(config, dimensions, &state);
    // The first one also makes buffers.
    algorithm.update(&mut state, &shards)?;
    let start = Instant::now();
    let (mut updates, mut shortest) = (0, f64::INFINITY);
    while updates == 0 || start.elapsed().as_secs_f64() < seconds {
        let begun = Instant::now();
        algorithm.update(&mut state, &shards)?;
        shortest = shortest.min(begun.elapsed().as_secs_f64());
        updates += 1;
    }
    let steps = config.steps_per_iteration() as f64;
    Ok(json!({
        "env_steps_per_s": f64::from(updates) * steps / start.elapsed().as_secs_f64(),
        "best_env_steps_per_s": steps / shortest,
        "updates": updates,
        "precision": arithmetic.as_str(),
        "mflop_per_env_step": flops::per_env_step(config, dimensions) * 1e-6,
        "state_bytes": state.to_safetensors().len(),
    }))
}
