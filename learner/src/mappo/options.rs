//! The algorithm's options.

use proto::config::{Config, CriticState};

use crate::gae::Gae;
use crate::input_norm::Normalisation;
use crate::loss::{ActorLoss, CriticLoss};
use crate::optimizer_step::Descent;

/// The algorithm's options, from a configuration.
#[derive(Debug, Clone)]
pub(super) struct Options {
    pub(super) gae: Gae,
    pub(super) actor_loss: ActorLoss,
    pub(super) critic_loss: CriticLoss,
    pub(super) descent: Descent,
    pub(super) epochs: usize,
    pub(super) mini_batches: usize,
    pub(super) max_kl: f64,
    pub(super) target_kl: f64,
    pub(super) value_norm_beta: Option<f64>,
    pub(super) normalize_advantage: bool,
    pub(super) normalisation: Normalisation,
    pub(super) own_critic_state: bool,
    pub(super) seed: u64,
}

impl Options {
    /// Those of a configuration.
    pub(super) fn new(config: &Config) -> Self {
        let a = &config.algorithm;
        Self {
            gae: Gae {
                gamma: a.gamma,
                lambda: a.gae_lambda,
                bootstrap_truncated: a.bootstrap_truncated,
            },
            actor_loss: ActorLoss {
                clip: a.clip,
                dual_clip: a.dual_clip,
                multiplier: a.surrogate_multiplier,
                entropy_coefficient: a.entropy_coefficient,
                squash_mean: config.network.squash_mean,
                min_log_std: config.network.min_log_std,
            },
            critic_loss: CriticLoss {
                clip: a.value_clip,
                huber_delta: a.huber_delta,
                coefficient: a.value_coefficient,
            },
            descent: Descent::new(config),
            epochs: a.epochs,
            mini_batches: a.mini_batches,
            max_kl: a.max_kl,
            target_kl: config.optimizer.target_kl,
            value_norm_beta: a.value_norm.then_some(a.value_norm_beta),
            normalize_advantage: a.normalize_advantage,
            normalisation: Normalisation::new(&config.network),
            own_critic_state: config.network.critic_state == CriticState::Own,
            seed: config.run.seed,
        }
    }
}
