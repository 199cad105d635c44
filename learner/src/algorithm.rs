//! The algorithm of a run.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use proto::config::{AlgorithmName, Config};
use proto::layout::Dimensions;

use crate::LearnerError;
use crate::maddpg::Maddpg;
use crate::mappo::Mappo;
use crate::report::UpdateReport;
use crate::state::TrainingState;
use crate::update::Update as _;

/// What makes an update of an iteration's samples.
#[derive(Debug)]
pub enum Algorithm {
    /// PPO with as many actors and such critics as the configuration says.
    Ppo(Box<Mappo>),
    /// MADDPG.
    Maddpg(Box<Maddpg>),
}

impl Algorithm {
    /// The one of `config`, with its buffers; `state` says precision and device.
    pub fn new(config: &Config, dimensions: &Dimensions, state: &TrainingState) -> Self {
        match config.algorithm.name {
            AlgorithmName::Mappo | AlgorithmName::Ippo | AlgorithmName::Ppo => {
                Self::Ppo(Box::new(Mappo::new(config, dimensions, state)))
            }
            AlgorithmName::Maddpg => Self::Maddpg(Box::new(Maddpg::new(config, dimensions, state))),
        }
    }

    /// See [`crate::update::Update::work`].
    pub fn work(&self) -> Arc<AtomicU64> {
        match self {
            Self::Ppo(mappo) => mappo.work(),
            Self::Maddpg(maddpg) => maddpg.work(),
        }
    }

    /// See [`crate::update::Update::update`].
    pub fn update(
        &mut self,
        state: &mut TrainingState,
        shards: &[&[f32]],
    ) -> Result<UpdateReport, LearnerError> {
        match self {
            Self::Ppo(mappo) => mappo.update(state, shards),
            Self::Maddpg(maddpg) => maddpg.update(state, shards),
        }
    }
}
