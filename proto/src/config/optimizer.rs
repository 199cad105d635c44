//! Group `optimizer`: Adam and the course of its learning rates.

use serde::{Deserialize, Serialize};

/// How the learning rate moves over the planned env-steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Stays.
    Constant,
    /// Falls linearly to zero at the last planned env-step.
    Linear,
}

/// Group `optimizer`: Adam (Kingma and Ba 2015).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optimizer {
    /// Initial learning rate of actors.
    pub actor_lr: f64,
    /// Initial learning rate of critics.
    pub critic_lr: f64,
    /// Course of the learning rates.
    pub schedule: Schedule,
    /// KL divergence (nats) of an iteration that actors' learning rates aim at; 0 leaves them to the schedule. An
    /// actor that went twice as far learns 1.5 times slower from then on, one that went less than half as far 1.5
    /// times faster, though never faster than scheduled. MADDPG does not use it.
    #[serde(default)]
    pub target_kl: f64,
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// ε of the denominator.
    pub epsilon: f64,
}
