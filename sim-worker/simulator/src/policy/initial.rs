//! Parameters of an untrained policy.

use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions};
use proto::rng::{Address, Purpose};

/// Actors like those that a training begins with: weights of the learner's scale, normal instead of
/// orthogonal, so that actions are of the same size. Actors that learn as one network begin as one.
pub fn initial_parameters(config: &Config, dimensions: &Dimensions, seed: u64) -> Vec<f32> {
    let layout = ActorLayout::new(config, dimensions);
    let mut parameters = vec![0.0; layout.len];
    for (index, tensor) in layout.tensors.iter().enumerate() {
        let fan_in = tensor.shape[1] as f64;
        let part = &mut parameters[tensor.range()];
        let name = tensor.name.as_str();
        match (name, name.rsplit('.').next().unwrap_or_default()) {
            ("head.weight", _) => {
                fill(part, (seed, index), config.network.head_gain / fan_in.sqrt());
            }
            ("log_std", _) => {
                for (agent, joints) in part.chunks_exact_mut(dimensions.n_actions).enumerate() {
                    joints.fill(config.network.initial_log_std_of(agent) as f32);
                }
            }
            (_, "weight") => fill(part, (seed, index), (2.0 / fan_in).sqrt()),
            (_, "gain" | "inverse_std") => part.fill(1.0),
            _ => {}
        }
        let networks = config.network.actor_networks(dimensions.n_actors);
        let row = part.len() / dimensions.n_actors;
        for actor in networks..dimensions.n_actors {
            part.copy_within(actor % networks * row..(actor % networks + 1) * row, actor * row);
        }
    }
    parameters
}

/// Normal numbers of a deviation.
fn fill(part: &mut [f32], (seed, tensor): (u64, usize), deviation: f64) {
    let purpose = Purpose::Initialisation;
    for (step, four) in part.chunks_mut(4).enumerate() {
        let (iteration, step) = (tensor as u32, step as u32);
        let address = Address { seed, purpose, iteration, env: 0, step, index: 0 };
        four.iter_mut().zip(address.normals()).for_each(|(x, z)| *x = z * deviation as f32);
    }
}

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};

    use super::*;

    #[test]
    fn actors_are_of_the_scale_that_training_begins_with() {
        let config = Layers::new(Preset::Paper, None).resolve().expect("valid");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        let parameters = initial_parameters(&config, &dimensions, 1);
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
    }

    #[test]
    fn actors_that_share_a_network_begin_as_one() {
        let config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        let parameters = initial_parameters(&config, &dimensions, 1);
        let policy = crate::policy::Policy::new(&config, &dimensions, &parameters);
        let policy = policy.expect("of this configuration");
        assert_eq!(policy.sharing(), [[0, 2, 4, 6], [1, 3, 5, 7]]);
    }
}
