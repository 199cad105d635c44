//! One step of an optimiser: a network's gradient, clipped, and Adam.
//!
//! **A deviation stops at its floor** (`network.min_log_std`). After each step its parameter is brought back
//! there, since below it there is no gradient that would.

use proto::config::{Config, Schedule};
use tch::{Device, Kind, Tensor};

use crate::LearnerError;
use crate::actors::Actors;
use crate::adam::{Adam, AdamOptions, ScaledGradient, clip_factors};
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
    /// `[A, P]`: that of the sum of a network's agents, unclipped. Means something where it is learned ([`NetworkSpec::learned_parts`]).
    pub(crate) gradient: Tensor,
    scratch: Tensor,
    /// Memory of [`NetworkRows::take`], if it copies.
    taken: Option<[Tensor; 3]>,
    /// The last unclipped gradient, kept if there is something to replace.
    pub(crate) recorded: Option<Tensor>,
}

/// One kind of network of some actors where it lies, among others: their part of the state, to be taken by whichever thread computes it.
pub(crate) struct NetworkRows {
    spec: NetworkSpec,
    actors: Actors,
    steps: Vec<i64>,
    /// Parameters and both moments of all actors.
    all: [Tensor; 3],
}

impl NetworkRows {
    /// The part of `actors`.
    pub(crate) fn new(network: &NetworkState, actors: Actors) -> Self {
        let Adam { m, v, steps } = &network.adam;
        Self {
            spec: network.spec.part(&actors.iter().collect::<Vec<_>>()),
            actors,
            steps: actors.iter().map(|actor| steps[actor]).collect(),
            all: [&network.flat, m, v].map(Tensor::shallow_clone),
        }
    }

    /// The part without gaps: in the state's memory if the actors stand side by side; if not, what is learned is copied into memory that `passes` keep.
    pub(crate) fn take(self, passes: &mut NetworkPasses) -> NetworkPart {
        let Self { spec, actors, steps, all } = self;
        let rows = all.map(|tensor| actors.rows(&tensor));
        let [flat, m, v] = if actors.are_side_by_side() {
            rows.each_ref().map(Tensor::shallow_clone)
        } else {
            let zeros = || {
                rows.each_ref().map(|rows| Tensor::zeros(rows.size(), (rows.kind(), rows.device())))
            };
            let taken = passes.taken.get_or_insert_with(zeros);
            for (taken, rows) in taken.iter().zip(&rows) {
                let parts = spec.learned_parts(taken).into_iter().zip(spec.learned_parts(rows));
                parts.for_each(|(mut taken, learned)| taken.copy_(&learned));
            }
            taken.each_ref().map(Tensor::shallow_clone)
        };
        NetworkPart { spec, flat, adam: Adam { m, v, steps }, rows }
    }
}

/// What was taken of [`NetworkRows`]. Of shared networks parameters and moments mean nothing where they are not learned.
pub(crate) struct NetworkPart {
    pub(crate) spec: NetworkSpec,
    pub(crate) flat: Tensor,
    pub(crate) adam: Adam,
    /// Where it came from: parameters and both moments, `[A, P]`.
    rows: [Tensor; 3],
}

impl NetworkPart {
    /// Brings what was learned into the state's memory, but for the counts of steps.
    ///
    /// All rows of a shared network become those that were learned.
    pub(crate) fn put_back(&self) {
        for (part, rows) in [&self.flat, &self.adam.m, &self.adam.v].into_iter().zip(&self.rows) {
            self.spec.spread(part, rows);
        }
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
            taken: None,
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

    /// Steps against the mean of what a network's agents say, clipped, each actor at its rate; returns its norms before clipping. A step with a gradient that
    /// is not finite is not made.
    pub(crate) fn step(
        &self,
        learned: &mut NetworkPart,
        passes: &mut NetworkPasses,
        learning_rates: &[f64],
        active: &[bool],
    ) -> Vec<f64> {
        let NetworkPasses { gradient, scratch, recorded, .. } = passes;
        let NetworkPart { spec, flat, adam, .. } = learned;
        // The passes have summed the losses of a network's agents. Their mean is what it learns from.
        let agents = spec.rows_per_network() as f64;
        if recorded.is_some() {
            let all = &*gradient / agents;
            spec.unify(&all);
            *recorded = Some(all);
        }
        let squared = spec.squared_norms(gradient);
        let norms: Vec<f64> =
            squared.into_iter().map(|squared| f64::from(squared).sqrt() / agents).collect();
        if norms.iter().all(|norm| norm.is_finite()) {
            let clipped = clip_factors(&norms, self.max_grad_norm);
            let factors: Vec<f32> =
                clipped.into_iter().map(|factor| factor / agents as f32).collect();
            let gradient = ScaledGradient { sum: gradient, factors: &factors };
            let columns = |row| spec.learned_columns(row);
            adam.step(&self.adam, learning_rates, flat, &gradient, scratch, active, columns);
        }
        norms
    }
}

/// Refuses norms that are not finite; `place` says of which step of the iteration they are.
pub(crate) fn check(
    norms: &[f64],
    network: &'static str,
    actors: Actors,
    iteration: u64,
    place: impl FnOnce() -> String,
) -> Result<(), LearnerError> {
    match norms.iter().position(|norm| !norm.is_finite()) {
        None => Ok(()),
        Some(index) => Err(LearnerError::Diverged {
            network,
            agent: actors.first + actors.step * index,
            iteration,
            place: place(),
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

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Layers, Preset, TaskName};
    use proto::layout::Dimensions;

    use super::*;
    use crate::network::NetworkKind;

    /// Two agents of one network: it learns from the mean of both, clipped or not.
    #[test]
    fn a_shared_network_steps_against_the_mean_of_its_agents() {
        let mut layers = Layers::new(Preset::Release, Some(TaskName::Trajectory));
        for assignment in ["network.parameter_sharing=all", "network.hidden=[4]"] {
            layers = layers.set(assignment).expect("well formed");
        }
        let mut config = layers.resolve().expect("valid");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(1));
        let spec = NetworkSpec::new(NetworkKind::Critic, &config, &dimensions);
        let all = Actors::all(spec.rows);
        assert_eq!((spec.rows, spec.n_networks), (2, 1));
        for limit in [0.0, 0.25, 1e6] {
            config.algorithm.max_grad_norm = limit;
            let flat = spec.initial(&config.network, 1);
            let adam = Adam::new(&flat);
            let state = NetworkState { spec: spec.clone(), flat, adam };
            let threads = Threads::One;
            let (kind, device) = (Kind::Float, Device::Cpu);
            let mut passes = NetworkPasses::new(&config, &state, &all, kind, device, threads);
            let sum = Tensor::arange(2 * spec.len, (kind, device)).view([2, -1]) * 1e-3;
            passes.gradient.copy_(&sum);
            passes.record(true);
            let mut part = NetworkRows::new(&state, all).take(&mut passes);
            let norms = Descent::new(&config).step(&mut part, &mut passes, &[1e-3; 2], &[true; 2]);
            let mean = &sum / 2.0;
            let norm = f64::from(spec.squared_norms(&mean)[0]).sqrt();
            assert!(norms.iter().all(|found| (found / norm - 1.0).abs() < 1e-6), "{norms:?}");
            let clipped = if limit > 0.0 { (limit / norm).min(1.0) } else { 1.0 };
            // The first moment after one step.
            let share = 1.0 - config.optimizer.beta1;
            for name in ["head.weight", "hidden.0.bias"] {
                let found = spec.learned(name, &part.adam.m);
                let expected = spec.learned(name, &mean) * (share * clipped);
                let error = (found - &expected).norm() / expected.norm();
                assert!(error.double_value(&[]) < 1e-5, "{name}, limit {limit}");
            }
            let recorded = passes.recorded.as_ref().expect("asked for");
            let bias = spec.learned("hidden.0.bias", recorded);
            assert_eq!(bias, spec.learned("hidden.0.bias", &mean), "unclipped");
        }
    }
}
