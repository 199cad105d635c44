//! Multi-agent deep deterministic policy gradient.
//!
//! Lowe, Wu, Tamar, Harb, Abbeel and Mordatch, "Multi-agent actor-critic for mixed
//! cooperative-competitive environments", NeurIPS 2017, algorithm 1. Every agent i has a deterministic
//! actor μ_i, a critic Q_i that sees everything and all agents' actions, and a slowly following copy of
//! both, the targets μ′_i and Q′_i. The workers' episodes go into a [`replay`](crate::state::replay); an update draws a batch
//! of steps (x, a, r, x′) from it, the same for all agents, and makes for each agent, in this order,
//!
//! ```text
//! y_i = r_i + γ Q′_i(x′, μ′_1(o′_1), …, μ′_A(o′_A))                           (equation 6)
//! a step of Adam on mean (Q_i(x, a_1, …, a_A) − y_i)²                         (equation 6)
//! a step of Adam on −mean Q_i(x, a_1, …, a_i = μ_i(o_i), …, a_A)              (equation 5)
//! θ′_i ← τ θ_i + (1 − τ) θ′_i
//! ```
//!
//! All agents make a step before any agent's target moves.
//!
//! **Actions.** An actor's output is L·tanh(·), L being `algorithm.maddpg.action_limit`; critics see
//! actions in units of L. The replay keeps actions as they were taken. (The code released with the paper
//! that we follow divides the batch's actions in place, once for every agent that uses it, so that most
//! critics see hardly any action; that is a mistake and not repeated.)
//!
//! **What is seen** is normalised as for MAPPO, with the moments in force; actions are not, they stand
//! beside it. There is no value normalisation.
//!
//! **When.** After the episodes of an iteration are in, as many updates follow as
//! `algorithm.maddpg.updates_per_step` makes of its env-steps. Rows are drawn by address, from iteration
//! and update, so nothing is lost by a stop.
//!
//! All agents go through each operation together; libtorch spreads it over the threads.
//!
//! Letters: `A` agents, `O` what one sees, `S` what critics see of the environment, `U` actions of an
//! agent, `B` samples of a batch, `F = S + A·U`.
//!
//! Why together: every update of an agent needs all agents' targets, so agents that were taken apart, as MAPPO's
//! are, would wait for one another thousands of times an iteration.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use proto::config::{Config, Maddpg as Settings};
use proto::layout::{BlockLayout, Dimensions};
use proto::rng::{Address, Purpose};
use tch::{Device, Kind, Tensor};

use crate::LearnerError;
use crate::actors::Actors;
use crate::input_norm::{InputNorm, Normalisation};
use crate::mlp::Threads;
use crate::optimizer_step::{
    Descent, NetworkPart, NetworkPasses, NetworkRows, check, learning_rates,
};
use crate::report::{Sums, UpdateReport, add};
use crate::state::replay::Batch;
use crate::state::{NetworkState, OffPolicy, TrainingState};
use crate::update::Update;

/// What an update computed on its way; kept only on request, for tests.
#[derive(Debug, Default)]
pub struct MaddpgTrace {
    /// Rows of the replay, of every update.
    pub rows: Vec<Vec<i64>>,
    /// Targets y `[A, B]`, of every update.
    pub targets: Vec<Tensor>,
    /// Unclipped gradients `[A, P]` of actors and critics, of every update.
    pub gradients: Vec<(Tensor, Tensor)>,
    /// Losses `[A]` of actors and critics, of every update.
    pub losses: Vec<(Vec<f64>, Vec<f64>)>,
}

/// The update with its buffers.
#[derive(Debug)]
pub struct Maddpg {
    config: Config,
    dimensions: Dimensions,
    settings: Settings,
    normalisation: Normalisation,
    descent: Descent,
    actor: NetworkPasses,
    critic: NetworkPasses,
    /// `[A, U, 1]`: one where an action moves a joint; nothing where all do.
    with_joint: Option<Tensor>,
    batch: Batch,
    device: Device,
    kind: Kind,
    work: Arc<AtomicU64>,
}

/// Moments of what is seen, in force during an iteration: mean and inverse deviation, `[1, rows, features]`.
struct Moments {
    observation: Option<(Tensor, Tensor)>,
    state: Option<(Tensor, Tensor)>,
}

/// What all updates of an iteration share.
struct IterationSettings {
    moments: Moments,
    iteration: u64,
    actor_lr: f64,
    critic_lr: f64,
}

/// The networks as an update changes them.
struct Networks<'a> {
    actor: NetworkPart,
    critic: NetworkPart,
    target_actor: &'a mut Tensor,
    target_critic: &'a mut Tensor,
}

impl Maddpg {
    /// Buffers and options for `config`; `state` says precision and device.
    ///
    /// # Panics
    /// If `state` is not MADDPG's, or agents share networks.
    pub fn new(config: &Config, dimensions: &Dimensions, state: &TrainingState) -> Self {
        let (kind, device) = (state.arithmetic.kind(), state.device());
        let off_policy = state.off_policy.as_ref().expect("a state of MADDPG");
        assert!(!state.actor.spec.is_shared(), "every agent of MADDPG has networks of its own");
        let passes = |network: &NetworkState| {
            let all = Actors::all(dimensions.n_agents);
            NetworkPasses::new(config, network, &all, kind, device, Threads::Several)
        };
        let settings = config.algorithm.maddpg;
        Self {
            config: config.clone(),
            dimensions: *dimensions,
            normalisation: Normalisation::new(&config.network),
            descent: Descent::new(config),
            actor: passes(&state.actor),
            critic: passes(&state.critic),
            with_joint: dimensions.actions_with_joint().map(|flags| {
                let shape = [dimensions.n_agents as i64, dimensions.n_actions as i64, 1];
                Tensor::from_slice(&flags).view(shape).to_device(device)
            }),
            batch: off_policy.replay.batch(settings.batch_size),
            settings,
            device,
            kind,
            work: Arc::default(),
        }
    }
}

impl Update for Maddpg {
    type Trace = MaddpgTrace;

    fn work(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.work)
    }

    fn update_traced(
        &mut self,
        state: &mut TrainingState,
        shards: &[&[f32]],
        mut trace: Option<&mut MaddpgTrace>,
    ) -> Result<UpdateReport, LearnerError> {
        tch::set_num_threads(i32::try_from(self.config.run.learner_threads).unwrap_or(i32::MAX));
        state.begin_update(&self.dimensions, shards);
        let (actor_lr, critic_lr) = learning_rates(&self.config, state.env_steps);
        let shared = IterationSettings {
            moments: self.moments(state),
            iteration: state.iteration,
            actor_lr,
            critic_lr,
        };
        let env_steps = self.config.steps_per_iteration();
        let updates = self.settings.updates_until(state.env_steps + env_steps)
            - self.settings.updates_until(state.env_steps);

        let n = self.dimensions.n_agents;
        let TrainingState { actor, critic, off_policy, .. } = &mut *state;
        let OffPolicy { target_actor, target_critic, replay } =
            off_policy.as_mut().expect("a state of MADDPG");
        replay.insert(&self.dimensions, shards);
        let all = Actors::all(n);
        let mut networks = Networks {
            actor: NetworkRows::new(actor, all).take(&mut self.actor),
            critic: NetworkRows::new(critic, all).take(&mut self.critic),
            target_actor,
            target_critic,
        };
        for passes in [&mut self.actor, &mut self.critic] {
            passes.record(trace.is_some());
        }
        let mut sums = Sums::new(n);
        let mut explained = vec![0.0; n];
        for update in 0..updates {
            self.work.fetch_add(1, Ordering::Relaxed);
            let address = Address {
                seed: self.config.run.seed,
                purpose: Purpose::Replay,
                iteration: shared.iteration as u32,
                env: update as u32,
                step: 0,
                index: 0,
            };
            let rows = replay.draw(address, self.settings.batch_size);
            replay.gather(&rows, &mut self.batch);
            let target = tch::no_grad(|| {
                self.step(&shared, &mut networks, update as usize, &mut sums, &mut explained)
            })?;
            if let Some(trace) = trace.as_deref_mut() {
                let recorded = |passes: &NetworkPasses| {
                    passes.recorded.as_ref().map(Tensor::shallow_clone).expect("recorded")
                };
                trace.rows.push(rows.iter().map(|&row| row as i64).collect());
                trace.targets.push(target);
                trace.gradients.push((recorded(&self.actor), recorded(&self.critic)));
                trace.losses.push((sums.last_policy.clone(), sums.last_value.clone()));
            }
        }
        let steps = [networks.actor.adam.steps, networks.critic.adam.steps];
        [state.actor.adam.steps, state.critic.adam.steps] = steps;
        state.end_update(&self.dimensions, shards, env_steps)?;
        let exploration = self.settings.exploration(state.env_steps);
        for share in &mut explained {
            *share /= updates.max(1) as f64;
        }
        Ok(UpdateReport {
            entropy: vec![0.0; n],
            action_std: vec![exploration.std; n],
            explained_variance: explained,
            returns: returns(&self.dimensions, shards),
            actor_lr,
            critic_lr,
            ..sums.means()
        })
    }
}

impl Maddpg {
    fn moments(&self, state: &TrainingState) -> Moments {
        let rows = |norm: &Option<InputNorm>| {
            norm.as_ref().map(|norm| {
                let (mean, inverse_std) = norm.mean_and_inverse_std();
                let row = |x: &[f32]| {
                    let row = Tensor::from_slice(x).view([1, norm.rows as i64, -1]);
                    row.to_device(self.device)
                };
                (row(&mean), row(&inverse_std))
            })
        };
        Moments { observation: rows(&state.observation_norm), state: rows(&state.state_norm) }
    }

    /// `x` `[B, G·F]` as networks see it, each of `groups` G parts of a row standardised by itself.
    fn normalise(&self, x: &Tensor, moments: Option<&(Tensor, Tensor)>, groups: i64) -> Tensor {
        let size = x.size();
        let x = x.to_device(self.device).view([size[0], groups, -1]);
        self.normalisation.normalise(&x, moments).view(size.as_slice())
    }

    /// Inputs `[A, B, O]` of all actors for observations `[B, A·O]`.
    fn actor_input(&self, shared: &IterationSettings, observation: &Tensor) -> Tensor {
        let agents = self.dimensions.n_agents as i64;
        let x = self.normalise(observation, shared.moments.observation.as_ref(), agents);
        self.actor.compute.by_network(&x.to_kind(self.kind))
    }

    /// What critics see of the environment, `[B, S]`.
    fn critic_state(
        &self,
        shared: &IterationSettings,
        observation: &Tensor,
        state: Option<&Tensor>,
    ) -> Tensor {
        self.normalise(state.unwrap_or(observation), shared.moments.state.as_ref(), 1)
    }

    /// Inputs `[A, B, F]` of all critics, the same for all: states `[B, S]`, actions `[B, A·U]`.
    fn critic_input(&self, state: &Tensor, action: &Tensor) -> Tensor {
        self.critic.compute.for_all(&Tensor::cat(&[state, action], 1).to_kind(self.kind))
    }

    /// An update on the batch at hand; returns the targets `[A, B]`.
    fn step(
        &mut self,
        shared: &IterationSettings,
        networks: &mut Networks<'_>,
        update: usize,
        sums: &mut Sums,
        explained: &mut [f64],
    ) -> Result<Tensor, LearnerError> {
        let agents = self.dimensions.n_agents;
        let (a, u) = (agents as i64, self.dimensions.n_actions as i64);
        let b = self.settings.batch_size as i64;
        let (active, flags) = (vec![true; agents], self.with_joint.as_ref());
        let Networks { actor, critic, target_actor, target_critic } = networks;
        let mean = |x: Tensor| {
            Vec::<f64>::try_from(x.mean_dim(&[1i64][..], false, Kind::Double))
                .expect("one number an agent")
        };

        let batch = &self.batch;
        let next_state =
            self.critic_state(shared, &batch.next_observation, batch.next_state.as_ref());
        let state = self.critic_state(shared, &batch.observation, batch.state.as_ref());
        let next_seen = self.actor_input(shared, &batch.next_observation);
        let seen = self.actor_input(shared, &batch.observation);
        let taken = batch.action.to_device(self.device) / self.settings.action_limit;
        let reward = batch.reward.to_device(self.device).transpose(0, 1);
        let future = batch.future.to_device(self.device) * self.config.algorithm.gamma;

        self.actor.compute.load(target_actor);
        let next_action = with_joint(self.actor.compute.forward(&next_seen).tanh(), flags);
        let next_action = next_action.permute([2, 0, 1]).reshape([b, a * u]);
        self.critic.compute.load(target_critic);
        let x = self.critic_input(&next_state, &next_action);
        let target = self.critic.compute.forward(&x).squeeze_dim(1) * future + reward;

        let x = self.critic_input(&state, &taken);
        let NetworkPasses { compute, gradient, .. } = &mut self.critic;
        compute.load(&critic.flat);
        let error = compute.forward(&x).squeeze_dim(1) - &target;
        // d/dQ of mean (Q − y)².
        compute.backward(&x, &(&error * (2.0 / b as f64)).unsqueeze(1), gradient);
        compute.unfold(&critic.flat, gradient);
        let norms =
            self.descent.step(critic, &mut self.critic, &vec![shared.critic_lr; agents], &active);
        check(&norms, "critic", Actors::all(agents), shared.iteration, || {
            format!("update {update}")
        })?;
        sums.critic(mean(error.square()).into_iter(), &norms);
        let variance = |x: &Tensor| x.to_kind(Kind::Double).var_dim(&[1i64][..], false, false);
        let share = 1.0 - variance(&error) / variance(&target).clamp_min(1e-12);
        add(explained, Vec::<f64>::try_from(share).expect("one number an agent").into_iter());

        // Each agent's own action is its actor's now, the others' are those that were taken.
        self.actor.compute.load(&actor.flat);
        let action = self.actor.compute.forward(&seen).tanh();
        let x = self.critic_input(&state, &taken).contiguous();
        let own = |agent: i64| state.size()[1] + agent * u;
        let moving = with_joint(action.shallow_clone(), flags);
        for agent in 0..a {
            let mut slot = x.get(agent).narrow(1, own(agent), u);
            slot.copy_(&moving.get(agent).transpose(0, 1));
        }
        let critics = &mut self.critic.compute;
        critics.load(&critic.flat);
        let value = critics.forward(&x).squeeze_dim(1);
        // d/dQ of −mean Q.
        let slope = value.full_like(-1.0 / b as f64).unsqueeze(1);
        let columns: Vec<i64> = (0..a).map(own).collect();
        let d_action = critics.input_gradient(&x, &slope, &columns, u);
        // d tanh = 1 − tanh².
        let d_action = with_joint(d_action.transpose(1, 2), flags);
        let d_output = Tensor::tanh_backward(&d_action, &action);
        let NetworkPasses { compute, gradient, .. } = &mut self.actor;
        compute.backward(&seen, &d_output, gradient);
        compute.unfold(&actor.flat, gradient);
        let norms =
            self.descent.step(actor, &mut self.actor, &vec![shared.actor_lr; agents], &active);
        check(&norms, "actor", Actors::all(agents), shared.iteration, || {
            format!("update {update}")
        })?;
        let zeros = || std::iter::repeat_n(0.0, agents);
        sums.actor(&active, mean(-value).into_iter(), zeros(), zeros(), &norms);

        let _ = target_actor.lerp_(&actor.flat, self.settings.soft_update);
        let _ = target_critic.lerp_(&critic.flat, self.settings.soft_update);
        Ok(target)
    }
}

/// Actions `[A, U, B]`, or what belongs to them, zero where they move no joint.
fn with_joint(actions: Tensor, flags: Option<&Tensor>) -> Tensor {
    match flags {
        None => actions,
        Some(flags) => actions * flags,
    }
}

/// Mean undiscounted return of an episode, one entry an agent.
fn returns(dimensions: &Dimensions, shards: &[&[f32]]) -> Vec<f64> {
    let layout = BlockLayout::new(dimensions);
    let per_agent = dimensions.n_steps * dimensions.n_envs;
    let episodes = (dimensions.n_envs * shards.len()) as f64;
    (0..dimensions.n_agents)
        .map(|agent| {
            let start = layout.reward.start + agent * per_agent;
            let of_shard = |shard: &&[f32]| -> f64 {
                shard[start..start + per_agent].iter().map(|&reward| f64::from(reward)).sum()
            };
            shards.iter().map(of_shard).sum::<f64>() / episodes
        })
        .collect()
}

#[cfg(test)]
mod tests;
