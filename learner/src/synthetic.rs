//! Blocks of random numbers of plausible size, for benches and tests that need no robot.

use std::f64::consts::TAU;

use proto::config::Network;
use proto::layout::{BlockLayout, Dimensions};
use proto::rng::{Address, Purpose};

/// Of a log-probability: mean and deviation.
const LOG_PROB: [f32; 2] = [-4.3, 0.1];

/// As [`blocks`], but with actions as untrained actors explore, and their log-probabilities but for some noise: a first update moves
/// such actors no farther than it does in a training.
pub fn explored_blocks(network: &Network, dimensions: &Dimensions, seed: u64) -> Vec<Vec<f32>> {
    let layout = BlockLayout::new(dimensions);
    let (actions, samples) = (dimensions.n_actions, dimensions.n_steps * dimensions.n_envs);
    let flags = dimensions.actions_with_joint();
    let mut blocks = blocks(dimensions, seed);
    for block in &mut blocks {
        for index in 0..layout.log_prob.len() {
            let log_std = network.initial_log_std_of(index / samples);
            let noise = block[layout.log_prob.start + index] - LOG_PROB[0];
            let mut log_prob = f64::from(noise);
            let taken = &mut block[layout.action.start + index * actions..][..actions];
            for (number, action) in taken.iter_mut().enumerate() {
                let moves = flags
                    .as_ref()
                    .is_none_or(|flags| flags[index / samples * actions + number] > 0.0);
                if moves {
                    log_prob -= 0.5 * f64::from(*action).powi(2) + log_std + 0.5 * TAU.ln();
                }
                *action *= log_std.exp() as f32;
            }
            block[layout.log_prob.start + index] = log_prob as f32;
        }
    }
    blocks
}

/// One block a shard: normal observations, states, actions and rewards, log-probabilities around
/// those of a unit deviation, episodes cut by time after their last step.
pub fn blocks(dimensions: &Dimensions, seed: u64) -> Vec<Vec<f32>> {
    let layout = BlockLayout::new(dimensions);
    (0..dimensions.n_shards as u32)
        .map(|shard| {
            let mut words = (0u32..).flat_map(|step| {
                Address {
                    seed,
                    purpose: Purpose::ActionNoise,
                    iteration: 0,
                    env: shard,
                    step,
                    index: 0,
                }
                .normals()
            });
            let mut block = vec![0.0; layout.len];
            for range in [&layout.observation, &layout.state, &layout.action, &layout.reward] {
                block[range.clone()].iter_mut().zip(&mut words).for_each(|(x, w)| *x = w);
            }
            let noise = words.map(|w| LOG_PROB[1] * w + LOG_PROB[0]);
            block[layout.log_prob.clone()].iter_mut().zip(noise).for_each(|(x, w)| *x = w);
            let truncated = &mut block[layout.truncated.clone()];
            let last = truncated.len() - dimensions.n_envs;
            truncated[last..].fill(1.0);
            block
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};

    use super::*;

    #[test]
    fn what_actors_explore_has_their_density() {
        let layers = Layers::new(Preset::Tuned, None).set("env.n_envs=8").expect("well formed");
        let config = layers.resolve().expect("valid");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(2));
        let layout = BlockLayout::new(&dimensions);
        let block = &explored_blocks(&config.network, &dimensions, 1)[0];
        let (actions, densities) = (&block[layout.action.clone()], &block[layout.log_prob.clone()]);
        let each = actions.len() / dimensions.n_agents;
        for (agent, actions) in actions.chunks_exact(each).enumerate() {
            let square = actions.iter().map(|a| f64::from(*a).powi(2)).sum::<f64>() / each as f64;
            let std = config.network.initial_log_std_of(agent).exp();
            assert!((square.sqrt() / std - 1.0).abs() < 0.1, "agent {agent}: {square}");
        }
        // The first agent's first sample.
        let std = config.network.initial_log_std_of(0).exp();
        let density = |a: &f32| {
            let z = f64::from(*a) / std;
            -0.5 * z * z - (std * TAU.sqrt()).ln()
        };
        let expected: f64 = actions[..dimensions.n_actions].iter().map(density).sum();
        assert!((f64::from(densities[0]) - expected).abs() < 0.6, "{} {expected}", densities[0]);
    }
}
