//! What training off policy keeps beside the networks.

use proto::config::Config;
use proto::layout::Dimensions;
use tch::Tensor;

use super::NetworkState;
use super::replay::Replay;

/// What only MADDPG's training state holds.
#[derive(Debug)]
pub struct OffPolicy {
    /// `[A, P]`: the target actors' parameters θ′.
    pub target_actor: Tensor,
    /// `[A, P]`: the target critics'.
    pub target_critic: Tensor,
    /// The episodes.
    pub replay: Replay,
}

impl OffPolicy {
    /// Targets that equal the networks, and an empty replay.
    pub(crate) fn new(
        config: &Config,
        dimensions: &Dimensions,
        actor: &NetworkState,
        critic: &NetworkState,
    ) -> Self {
        Self {
            target_actor: actor.flat.copy(),
            target_critic: critic.flat.copy(),
            replay: Replay::new(config, dimensions),
        }
    }
}
