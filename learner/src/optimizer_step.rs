//! One step of an optimiser: a network's gradient, clipped, and Adam.
//!
//! **A deviation stops at its floor** (`network.min_log_std`). After each step its parameter is brought back
//! there, since below it there is no gradient that would.

use proto::config::{Config, Schedule};
use tch::{Device, Kind, Tensor};

use crate::LearnerError;
use crate::actors::Actors;
use crate::adam::{Adam, AdamOptions, clip_gradient};
use crate::mlp::{Compute, Threads};
use crate::network::NetworkSpec;
use crate::state::NetworkState;

/// What steps need of a configuration.
#[derive(Debug, Clone)]
pub(crate) struct Descent {
    adam: AdamOptions,
    max_grad_norm: f64,
}

/// One kind of network of some actors: passes and buffers.
#[derive(Debug)]
pub(crate) struct NetworkPasses {
    pub(crate) compute: Compute,
    /// `[A, P]`. Means something where it is learned ([`NetworkSpec::learned_parts`]).
    pub(crate) gradient: Tensor,
    scratch: Tensor,
    /// The last unclipped gradient, kept if there is something to replace.
    pub(crate) recorded: Option<Tensor>,
}

/// One kind of network of some actors: their part of the state, in the state's memory or copied. Of shared networks parameters and moments are those of
/// before the update, where they are not learned, until [`NetworkPart::put_back`].
pub(crate) struct NetworkPart {
    pub(crate) spec: NetworkSpec,
    pub(crate) flat: Tensor,
    pub(crate) adam: Adam,
}

impl NetworkPart {
    /// The part of `actors`, in the state's memory if they stand side by side.
    pub(crate) fn part(network: &NetworkState, actors: &Actors) -> Self {
        let part = |tensor: &Tensor| actors.of(tensor);
        let Adam { m, v, steps } = &network.adam;
        let steps = actors.iter().map(|actor| steps[actor]).collect();
        Self {
            spec: network.spec.part(&actors.iter().collect::<Vec<_>>()),
            flat: part(&network.flat),
            adam: Adam { m: part(m), v: part(v), steps },
        }
    }

    /// Brings what was learned into the state's memory, but for the counts of steps.
    ///
    /// All rows of a shared network become those that were learned.
    pub(crate) fn put_back(&self, network: &NetworkState, actors: &Actors) {
        for tensor in [&self.flat, &self.adam.m, &self.adam.v] {
            self.spec.unify(tensor);
        }
        let Adam { m, v, .. } = &network.adam;
        actors.put_back(&self.flat, &network.flat);
        actors.put_back(&self.adam.m, m);
        actors.put_back(&self.adam.v, v);
    }
}

impl NetworkPasses {
    /// For the networks of `actors` among those of `network`, with products in `kind` by `threads`.
    pub(crate) fn new(
        config: &Config,
        network: &NetworkState,
        actors: &Actors,
        kind: Kind,
        device: Device,
        threads: Threads,
    ) -> Self {
        let flat = network.flat.narrow(0, 0, actors.len as i64);
        let spec = network.spec.part(&actors.iter().collect::<Vec<_>>());
        Self {
            compute: Compute::new(&spec, config.network.activation, kind, device, threads),
            gradient: flat.zeros_like(),
            scratch: flat.zeros_like(),
            recorded: None,
        }
    }

    /// From now on keeps each unclipped gradient, or none.
    pub(crate) fn record(&mut self, wanted: bool) {
        self.recorded = wanted.then(|| self.gradient.shallow_clone());
    }
}

impl Descent {
    /// The options of a configuration.
    pub(crate) fn new(config: &Config) -> Self {
        let optimizer = &config.optimizer;
        Self {
            adam: AdamOptions {
                beta1: optimizer.beta1,
                beta2: optimizer.beta2,
                epsilon: optimizer.epsilon,
            },
            max_grad_norm: config.algorithm.max_grad_norm,
        }
    }

    /// Clips a network's gradient and steps, each actor at its rate; returns its norms before clipping. A step with a gradient that
    /// is not finite is not made.
    pub(crate) fn step(
        &self,
        learned: &mut NetworkPart,
        passes: &mut NetworkPasses,
        learning_rates: &[f64],
        active: &[bool],
    ) -> Vec<f64> {
        let NetworkPasses { gradient, scratch, recorded, .. } = passes;
        let NetworkPart { spec, flat, adam } = learned;
        spec.average_gradient(gradient);
        if recorded.is_some() {
            let all = gradient.copy();
            spec.unify(&all);
            *recorded = Some(all);
        }
        let squared = spec.squared_norm(gradient);
        let norms = clip_gradient(&spec.learned_parts(gradient), &squared, self.max_grad_norm);
        if norms.iter().all(|norm| norm.is_finite()) {
            let columns = |row| spec.learned_columns(row);
            adam.step(&self.adam, learning_rates, flat, gradient, scratch, active, columns);
        }
        norms
    }
}

/// Refuses norms that are not finite; `step` is epoch and mini-batch.
pub(crate) fn check(
    norms: &[f64],
    network: &'static str,
    actors: Actors,
    iteration: u64,
    (epoch, mini_batch): (usize, usize),
) -> Result<(), LearnerError> {
    match norms.iter().position(|norm| !norm.is_finite()) {
        None => Ok(()),
        Some(index) => Err(LearnerError::Diverged {
            network,
            agent: actors.first + actors.step * index,
            iteration,
            epoch,
            mini_batch,
        }),
    }
}

/// The learning rates of actors and critics after `env_steps`.
pub(crate) fn learning_rates(config: &Config, env_steps: u64) -> (f64, f64) {
    let factor = match config.optimizer.schedule {
        Schedule::Constant => 1.0,
        Schedule::Linear => (1.0 - env_steps as f64 / config.run.env_steps as f64).max(0.0),
    };
    (config.optimizer.actor_lr * factor, config.optimizer.critic_lr * factor)
}
