//! The update: what a learner makes of an iteration's samples.
//!
//! Yu et al. 2022, algorithm 1, with separate networks for every agent (or some that several share, or
//! one that acts for all), in this order:
//!
//! 1. inputs are normalised as the policy that acted saw them, and gathered sample by sample;
//! 2. critics predict values; advantages by [`gae`](crate::gae) on denormalised values;
//! 3. each epoch first updates the value normaliser with the returns, then splits a permutation of
//!    the samples into mini-batches; each is one Adam step for actors, then one for critics;
//! 4. input normalisers take in the iteration's samples.
//!
//! **Threads.** Actors with networks of their own have nothing in common, so on a CPU each is a group
//! of its own, whose parameters, moments and gradients stay in a core's cache for the whole update;
//! threads take one group after another. What an actor learns does not depend on who computes it, nor
//! on the number of threads, up to one a group. The actors of a shared network are one group; within a
//! group all actors go through each operation together, and libtorch spreads the operations over the
//! threads that have no group of their own. On a GPU all networks are one group. For one number of threads the result is always the same to the
//! bit.
//!
//! **Agents and actors.** Blocks are written by agent; networks belong to actors (see
//! [`proto::layout`]), which mostly are the same. Centralised PPO has one actor for all agents: it sees
//! their observations one after the other, its action is all of theirs, the density of which is the
//! product of theirs, and it is paid the sum of their rewards. That is settled where samples are
//! gathered; nothing after it knows of agents.
//!
//! **Copies.** The first operation that reads a block is the normalisation (of observations) or the
//! packing of what the loss needs into one row a sample; blocks are not copied before.
//!
//! Letters: `A` actors of a group, `G` agents of an actor, `T` steps, `E` environments of all shards,
//! `M = T·E` samples, `O` what an actor sees, `S` critic state, `U` actions of an actor, `B` samples of a
//! chunk.

mod group;
mod samples;

use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

use proto::config::{Config, CriticState};
use proto::layout::{BlockLayout, Dimensions};
use tch::Tensor;

use self::group::{Group, Job, Outcome};
use crate::LearnerError;
use crate::actors::Actors;
use crate::descent::{Descent, Half, Learned, learning_rates};
use crate::gae::Gae;
use crate::input_norm::{InputNorm, Normalisation};
use crate::loss::{ActorLoss, CriticLoss};
use crate::report::{UpdateReport, interleaved};
use crate::state::{NetworkState, TrainingState};

/// Samples that go through the networks at once on a CPU. Activations of so many fit in the cache; of
/// fewer, the gradients of weights are summed more often.
const CHUNK_ROWS: i64 = 1600;

/// What an update computed on its way; kept only on request, for tests.
#[derive(Debug, Default)]
pub struct Trace {
    /// `[A, T, E]`: advantages, not standardised.
    pub advantage: Option<Tensor>,
    /// `[A, T, E]`: returns.
    pub returns: Option<Tensor>,
    /// `[A, T + 1, E]`: predictions in normalised units.
    pub value: Option<Tensor>,
    /// Unclipped gradients `[A, P]` of actors and critics, of every optimiser step.
    pub gradients: Vec<(Tensor, Tensor)>,
    /// Mean losses `[A]` of actors (surrogate) and critics, of every optimiser step.
    pub losses: Vec<(Vec<f64>, Vec<f64>)>,
    /// Rows of every mini-batch.
    pub rows: Vec<Vec<i64>>,
}

/// The algorithm's options, from a configuration.
#[derive(Debug, Clone)]
struct Options {
    gae: Gae,
    actor_loss: ActorLoss,
    critic_loss: CriticLoss,
    descent: Descent,
    epochs: usize,
    mini_batches: usize,
    max_kl: f64,
    target_kl: f64,
    value_norm_beta: Option<f64>,
    normalize_advantage: bool,
    normalisation: Normalisation,
    own_critic_state: bool,
    seed: u64,
}

/// The update with its buffers.
#[derive(Debug)]
pub struct Mappo {
    config: Config,
    dimensions: Dimensions,
    layout: BlockLayout,
    options: Options,
    groups: Vec<Group>,
    /// How many groups are computed at once, and with how many of libtorch's threads each.
    threads: [usize; 2],
    work: Arc<AtomicU64>,
}

impl Mappo {
    /// Buffers and options for `config`; `state` says precision and device.
    pub fn new(config: &Config, dimensions: &Dimensions, state: &TrainingState) -> Self {
        let n_groups = if state.device().is_cuda() { 1 } else { state.actor.spec.n_networks };
        Self::in_groups(config, dimensions, state, n_groups)
    }

    /// As [`Mappo::new`], with all actors in one group, so that an update can be traced.
    pub fn in_one_group(config: &Config, dimensions: &Dimensions, state: &TrainingState) -> Self {
        Self::in_groups(config, dimensions, state, 1)
    }

    fn in_groups(
        config: &Config,
        dimensions: &Dimensions,
        state: &TrainingState,
        n_groups: usize,
    ) -> Self {
        let a = &config.algorithm;
        let options = Options {
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
        };
        let device = state.device();
        let kind = state.arithmetic.kind();
        let threads = config.run.learner_threads;
        let at_once = threads.min(n_groups);
        let groups = (0..n_groups)
            .map(|first| {
                let len = dimensions.n_actors / n_groups;
                let actors = Actors { first, step: n_groups, len };
                let half = |network: &NetworkState| Half::new(config, network, len, kind, device);
                Group {
                    actor: half(&state.actor),
                    critic: half(&state.critic),
                    chunk_rows: if device.is_cuda() { i64::MAX } else { CHUNK_ROWS },
                    actors,
                    device,
                    kind,
                }
            })
            .collect();
        Self {
            config: config.clone(),
            dimensions: *dimensions,
            layout: BlockLayout::new(dimensions),
            options,
            groups,
            threads: [at_once, threads / at_once],
            work: Arc::default(),
        }
    }

    /// A counter that grows with every mini-batch, to be watched from another thread: while an
    /// update is under way and it stands still, nothing is computed.
    pub fn work(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.work)
    }

    /// Trains `state` on the blocks of one iteration, ordered by shard.
    ///
    /// # Errors
    /// If a gradient is not finite; `state` is then worthless and must not be published.
    pub fn update(
        &mut self,
        state: &mut TrainingState,
        shards: &[&[f32]],
    ) -> Result<UpdateReport, LearnerError> {
        self.update_traced(state, shards, None)
    }

    /// [`Self::update`] that also records what it computed, if asked to. Only with one group.
    pub fn update_traced(
        &mut self,
        state: &mut TrainingState,
        shards: &[&[f32]],
        trace: Option<&mut Trace>,
    ) -> Result<UpdateReport, LearnerError> {
        assert!(trace.is_none() || self.groups.len() == 1, "one group can be traced");
        state.begin_update(&self.dimensions, shards);
        let (actor_lr, critic_lr) = learning_rates(&self.config, state.env_steps);
        let job = Job {
            shards,
            layout: &self.layout,
            dimensions: &self.dimensions,
            options: &self.options,
            work: &self.work,
            iteration: state.iteration,
            actor_lr: match &state.actor_rate {
                Some(rate) => rate.iter().map(|rate| rate * actor_lr).collect(),
                None => vec![actor_lr; self.dimensions.n_actors],
            },
            critic_lr,
            observation_norm: state.observation_norm.as_ref().map(InputNorm::mean_and_inverse_std),
            state_norm: state.state_norm.as_ref().map(InputNorm::mean_and_inverse_std),
        };
        let outcomes = run_groups(&mut self.groups, state, &job, self.threads, trace);
        let actor_lr = job.actor_lr.iter().sum::<f64>() / job.actor_lr.len() as f64;
        let mut report = UpdateReport { actor_lr, critic_lr, ..UpdateReport::default() };
        let (mut steps, mut parts) = ((Vec::new(), Vec::new()), Vec::new());
        let mut last_kl = Vec::new();
        for outcome in outcomes {
            let Outcome { actor_steps, critic_steps, last_kl: kl, report: part } = outcome?;
            steps.0.push(actor_steps);
            steps.1.push(critic_steps);
            last_kl.push(kl);
            parts.push(part);
        }
        report.interleave(parts);
        state.actor.adam.steps = interleaved(&steps.0);
        state.critic.adam.steps = interleaved(&steps.1);
        if let Some(rate) = &mut state.actor_rate {
            for (rate, kl) in rate.iter_mut().zip(interleaved(&last_kl)) {
                *rate = steered(*rate, kl, self.options.target_kl);
            }
        }
        state.end_update(&self.dimensions, shards, self.config.steps_per_iteration());
        Ok(report)
    }
}

/// Runs all groups, `at_once` of them at a time, the caller's thread being one that does; outcomes are
/// in the groups' order.
fn run_groups(
    groups: &mut [Group],
    state: &TrainingState,
    job: &Job<'_>,
    [at_once, threads]: [usize; 2],
    trace: Option<&mut Trace>,
) -> Vec<Result<Outcome, LearnerError>> {
    let mut outcomes: Vec<_> = groups.iter().map(|_| None).collect();
    let waiting: Vec<_> = groups
        .iter_mut()
        .zip(&mut outcomes)
        .map(|(group, outcome)| {
            let actors = group.actors;
            let learned =
                (Learned::part(&state.actor, &actors), Learned::part(&state.critic, &actors));
            let norm = state.value_norm.part(&actors);
            (group, learned, norm, outcome)
        })
        .collect();
    let waiting = Mutex::new(waiting.into_iter());
    let work = |mut trace: Option<&mut Trace>| {
        tch::set_num_threads(threads as i32);
        loop {
            let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).next();
            let Some((group, (mut actor, mut critic), norm, outcome)) = next else { break };
            let trace = trace.as_deref_mut();
            let result = tch::no_grad(|| group.update(job, &mut actor, &mut critic, norm, trace));
            *outcome = Some((result, group.actors, actor, critic));
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..at_once {
            scope.spawn(|| work(None));
        }
        work(trace);
    });
    let put_back = |outcome: Option<_>| {
        let (result, actors, actor, critic): (_, _, Learned, Learned) =
            outcome.expect("every group was computed");
        actor.put_back(&state.actor, &actors);
        critic.put_back(&state.critic, &actors);
        result
    };
    outcomes.into_iter().map(put_back).collect()
}

/// An actor's share of the scheduled learning rate after an iteration in which it moved by `kl`.
///
/// The factors are those of the adaptive penalty of Schulman et al. 2017, section 4, turned on the learning
/// rate as Rudin et al. 2021 do ("Learning to walk in minutes using massively parallel deep reinforcement
/// learning", appendix).
fn steered(rate: f64, kl: f64, target: f64) -> f64 {
    let steered = if kl > 2.0 * target {
        rate / RATE_FACTOR
    } else if kl < target / 2.0 {
        rate * RATE_FACTOR
    } else {
        rate
    };
    steered.clamp(LOWEST_RATE, 1.0)
}

/// Change of a steered learning rate from one iteration to the next.
const RATE_FACTOR: f64 = 1.5;
/// The smallest share of the scheduled learning rate.
const LOWEST_RATE: f64 = 1e-3;

#[cfg(test)]
mod tests;
