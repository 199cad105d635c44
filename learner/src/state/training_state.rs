//! Everything that training changes, and how an update begins and ends.

use proto::config::{AlgorithmName, Config, CriticState, InputNorm as InputNormKind};
use proto::layout::{ActorLayout, BlockLayout, Dimensions};
use tch::{Device, Kind};

use super::{NetworkState, OffPolicy};
use crate::LearnerError;
use crate::adam::Adam;
use crate::input_norm::InputNorm;
use crate::memory::bytes;
use crate::network::{NetworkKind, NetworkSpec};
use crate::precision::Arithmetic;
use crate::value_norm::ValueNorm;

/// Everything that training changes.
#[derive(Debug)]
pub struct TrainingState {
    /// The policies.
    pub actor: NetworkState,
    /// The critics.
    pub critic: NetworkState,
    /// Share of the scheduled learning rate in force, one an actor; only if it follows the KL divergence.
    pub actor_rate: Option<Vec<f64>>,
    /// Moments of the returns.
    pub value_norm: ValueNorm,
    /// Moments of the observations, one row an agent.
    pub observation_norm: Option<InputNorm>,
    /// Moments of the critic state.
    pub state_norm: Option<InputNorm>,
    /// Targets and replay; MADDPG only.
    pub off_policy: Option<OffPolicy>,
    /// Iterations trained on; also the version of the policy.
    pub iteration: u64,
    /// Env-steps trained on.
    pub env_steps: u64,
    /// The policy before the last update, as it was published.
    pub previous_policy: Vec<f32>,
    /// The products' arithmetic.
    pub arithmetic: Arithmetic,
    pub(super) policy_layout: ActorLayout,
    min_log_std: f64,
    device: Device,
}

impl TrainingState {
    /// The state before the first iteration.
    pub fn initial(
        config: &Config,
        dimensions: &Dimensions,
        arithmetic: Arithmetic,
        device: Device,
    ) -> Self {
        let network = |kind| {
            let spec = NetworkSpec::new(kind, config, dimensions);
            let flat = spec.initial(&config.network, config.run.seed).to_device(device);
            let adam = Adam::new(&flat);
            NetworkState { spec, flat, adam }
        };
        let running = config.network.input_norm == InputNormKind::Running;
        let own = config.network.critic_state == CriticState::Own;
        let policy_layout = ActorLayout::new(config, dimensions);
        let (actor, critic) = (network(NetworkKind::Actor), network(NetworkKind::Critic));
        let off_policy = (config.algorithm.name == AlgorithmName::Maddpg)
            .then(|| OffPolicy::new(config, dimensions, &actor, &critic));
        let mut state = Self {
            actor,
            critic,
            off_policy,
            actor_rate: (config.optimizer.target_kl > 0.0).then(|| vec![1.0; dimensions.n_actors]),
            value_norm: ValueNorm::new(dimensions.n_actors, device),
            observation_norm: running
                .then(|| InputNorm::new(dimensions.n_agents, dimensions.observation)),
            state_norm: (running && !own).then(|| InputNorm::new(1, dimensions.state)),
            iteration: 0,
            env_steps: 0,
            previous_policy: vec![0.0; policy_layout.len],
            arithmetic,
            policy_layout,
            min_log_std: config.network.min_log_std,
            device,
        };
        state.remember_policy();
        state
    }

    /// Takes the observations before each step of an iteration's blocks into the running normalisers.
    pub fn see(&mut self, dimensions: &Dimensions, shards: &[&[f32]]) {
        let layout = BlockLayout::new(dimensions);
        let Dimensions { n_steps: t, n_envs: n, observation: o, state: s, .. } = *dimensions;
        if let Some(norm) = &mut self.observation_norm {
            let rows: Vec<Vec<&[f32]>> = (0..norm.rows)
                .map(|agent| {
                    let start = layout.observation.start + agent * (t + 1) * n * o;
                    shards.iter().map(|shard| &shard[start..start + t * n * o]).collect()
                })
                .collect();
            norm.update(&rows);
            if self.actor.spec.is_shared() {
                norm.pool(self.actor.spec.n_networks);
            }
        }
        if let Some(norm) = &mut self.state_norm {
            let start = layout.state.start;
            norm.update(&[shards.iter().map(|shard| &shard[start..start + t * n * s]).collect()]);
        }
    }

    /// Begins an update with the blocks of one iteration, ordered by shard: the policy so far becomes the
    /// previous one, and normalisers that have seen nothing see these samples.
    pub(crate) fn begin_update(&mut self, dimensions: &Dimensions, shards: &[&[f32]]) {
        assert_eq!(shards.len(), dimensions.n_shards, "all shards of an iteration");
        let block_len = BlockLayout::new(dimensions).len;
        for shard in shards {
            assert_eq!(shard.len(), block_len, "a block of this run's layout");
        }
        self.remember_policy();
        if self.iteration == 0 {
            self.see(dimensions, shards);
        }
    }

    /// Ends it: later normalisers see the samples now, after these were learned from as the policy that
    /// acted saw them.
    ///
    /// # Errors
    /// If what was learned is of no use: nobody must get to see it.
    pub(crate) fn end_update(
        &mut self,
        dimensions: &Dimensions,
        shards: &[&[f32]],
        env_steps: u64,
    ) -> Result<(), LearnerError> {
        self.check_bounds()?;
        if self.iteration > 0 {
            self.see(dimensions, shards);
        }
        self.iteration += 1;
        self.env_steps += env_steps;
        Ok(())
    }

    /// Refuses parameters that are not finite, and deviations beyond all numbers: gradients that are finite can lead there.
    pub(super) fn check_bounds(&self) -> Result<(), LearnerError> {
        for network in [&self.actor, &self.critic] {
            let is_stochastic = network.spec.parameters.iter().any(|p| p.name == "log_std");
            // Once around all numbers, those of a shared network once. A sum in f64 is finite if they are.
            let whole = network.spec.learned_parts(&network.flat);
            let deviations = is_stochastic
                .then(|| network.spec.learned("log_std", &network.flat).exp())
                .map(|deviations| (deviations, 0, "deviations beyond all numbers"));
            // The second part begins behind the first.
            let parts = whole.into_iter().enumerate().map(|(index, part)| {
                (part, index * network.spec.n_networks, "parameters that are not finite")
            });
            for (part, first, what) in parts.chain(deviations) {
                let sums = part.sum_dim_intlist(&[1i64][..], false, Kind::Double);
                let sums = Vec::<f64>::try_from(sums).expect("a number a row");
                if let Some(row) = sums.iter().position(|sum| !sum.is_finite()) {
                    let agent = first + row;
                    let (network, iteration) = (network.spec.kind.as_str(), self.iteration);
                    return Err(LearnerError::Unbounded { network, agent, what, iteration });
                }
            }
        }
        Ok(())
    }

    /// Keeps the policy as it is now as the previous one.
    pub fn remember_policy(&mut self) {
        let mut policy = std::mem::take(&mut self.previous_policy);
        self.write_policy(&mut policy);
        self.previous_policy = policy;
    }

    /// Writes the actors into `out`, a policy as it is published.
    ///
    /// # Panics
    /// If `out` is not of the layout's length.
    #[expect(unsafe_code, reason = "parameters are read while nobody trains")]
    pub fn write_policy(&self, out: &mut [f32]) {
        let layout = &self.policy_layout;
        assert_eq!(out.len(), layout.len, "a policy has {} numbers", layout.len);
        let norm = self.observation_norm.as_ref().map(InputNorm::mean_and_inverse_std);
        let flat = self.actor.flat.to_device(Device::Cpu);
        // SAFETY: parameters are filled when they are made, and only read until the end of this function.
        let parameters: &[f32] = bytemuck::cast_slice(unsafe { bytes(&flat) });
        let row_len = flat.size()[1] as usize;
        for tensor in &layout.tensors {
            let slot = &mut out[tensor.range()];
            match (tensor.name.as_str(), &norm) {
                ("input.mean", Some((mean, _))) => slot.copy_from_slice(mean),
                ("input.inverse_std", Some((_, inverse_std))) => slot.copy_from_slice(inverse_std),
                (name, _) => {
                    let columns = self.actor.spec.get(name).columns();
                    let rows = parameters.chunks_exact(row_len);
                    for (part, row) in slot.chunks_exact_mut(columns.len().max(1)).zip(rows) {
                        part.copy_from_slice(&row[columns.clone()]);
                    }
                    if name == "log_std" {
                        for x in slot {
                            *x = x.max(self.min_log_std as f32);
                        }
                    }
                }
            }
        }
    }

    /// The device that it lives on.
    pub fn device(&self) -> Device {
        self.device
    }
}
