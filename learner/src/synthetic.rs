//! Blocks of random numbers of plausible size, for benches and tests that need no robot.

use proto::layout::{BlockLayout, Dimensions};
use proto::rng::{Address, Purpose};

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
            let noise = words.map(|w| 0.1 * w - 4.3);
            block[layout.log_prob.clone()].iter_mut().zip(noise).for_each(|(x, w)| *x = w);
            let truncated = &mut block[layout.truncated.clone()];
            let last = truncated.len() - dimensions.n_envs;
            truncated[last..].fill(1.0);
            block
        })
        .collect()
}
