//! Training states that no learner has made, for the tests of every crate that handles checkpoints.

use std::collections::{BTreeMap, HashMap};

use proto::DigestBuilder;
use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions};
use safetensors::{Dtype, tensor::TensorView};
use simulator::robot::Robot;

use super::{STATE_FORMAT, Snapshot, StateLayout};

/// A snapshot whose actors count up from `first` and whose critics from the iteration, with all
/// tensors that a learner would write and the digest that it would compute for them.
pub fn snapshot_of(config: &Config, iteration: u64, first: f32) -> Snapshot {
    let robot = Robot::builtin("paper").expect("built in");
    let dimensions = Dimensions::new(config, robot.joints);
    let actors = ActorLayout::new(config, &dimensions);
    let state = StateLayout::new(config, &dimensions);
    let count = |first: f32, numbers: std::ops::Range<usize>| -> Vec<u8> {
        numbers.flat_map(|index| (first + index as f32).to_le_bytes()).collect()
    };
    let mut tensors = BTreeMap::new();
    for (name, tensor) in state.tensors {
        let len = tensor.shape.iter().product::<usize>();
        let actor = name.strip_prefix("actor.").and_then(|parameter| actors.get(parameter));
        let bytes = match (name.as_str(), actor, tensor.dtype) {
            (_, Some(spec), _) => count(first, spec.range()),
            ("counters.iteration", ..) => iteration.to_le_bytes().into(),
            ("counters.env_steps", ..) => {
                (iteration * config.steps_per_iteration()).to_le_bytes().into()
            }
            ("counters.precision", ..) => 32_u64.to_le_bytes().into(),
            (_, _, Dtype::F32) => count(iteration as f32, 0..len),
            (_, _, Dtype::F64) => 0.5_f64.to_le_bytes().repeat(len),
            _ => iteration.to_le_bytes().repeat(len),
        };
        tensors.insert(name, (tensor.dtype, tensor.shape, bytes));
    }
    let mut digest = DigestBuilder::new();
    for (name, (_, _, bytes)) in &tensors {
        digest.field(name, bytes);
    }
    // Of moments that are one half everywhere.
    let moments = [("input.mean", 0.5_f32), ("input.inverse_std", (1.0_f32 + 1e-6).sqrt().recip())];
    for spec in &actors.tensors {
        let bytes = match moments.iter().find(|(name, _)| *name == spec.name) {
            Some((_, number)) => number.to_le_bytes().repeat(spec.range().len()),
            None => count(first, spec.range()),
        };
        let tensor = (Dtype::F32, spec.shape.clone(), bytes);
        tensors.insert(format!("policy.{}", spec.name), tensor);
    }
    let views = tensors.iter().map(|(name, (dtype, shape, bytes))| {
        (name.clone(), TensorView::new(*dtype, shape.clone(), bytes).expect("sized"))
    });
    let metadata = HashMap::from([("format".to_owned(), STATE_FORMAT.to_owned())]);
    let bytes = safetensors::serialize(views, Some(metadata)).expect("serialises");
    Snapshot { iteration, digest: digest.finish(), bytes }
}
