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

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use proto::config::{Config, CriticState, InputNorm as InputNormKind};
use proto::layout::{BlockLayout, Dimensions, JOINTS_PER_AGENT};
use proto::rng::{Address, Purpose, permutation};
use tch::{Device, Kind, Tensor};

use crate::LearnerError;
use crate::actors::Actors;
use crate::descent::{Descent, Half, Learned, check, learning_rates};
use crate::gae::{Gae, standardise};
use crate::input_norm::InputNorm;
use crate::loss::{ActorLoss, ActorSamples, CriticLoss};
use crate::memory::view;
use crate::mlp::standardise_input;
use crate::report::{Sums, UpdateReport, add, interleaved};
use crate::state::{NetworkState, TrainingState};
use crate::value_norm::ValueNorm;

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
    input_norm: InputNormKind,
    input_clip: f64,
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

/// Actors that are computed together.
#[derive(Debug)]
struct Group {
    actors: Actors,
    actor: Half,
    critic: Half,
    chunk_rows: i64,
    device: Device,
    kind: Kind,
}

/// What all groups read.
struct Job<'a> {
    shards: &'a [&'a [f32]],
    layout: &'a BlockLayout,
    dimensions: &'a Dimensions,
    options: &'a Options,
    /// Counts the mini-batches begun.
    work: &'a AtomicU64,
    iteration: u64,
    /// One an actor.
    actor_lr: Vec<f64>,
    critic_lr: f64,
    observation_norm: Option<(Vec<f32>, Vec<f32>)>,
    state_norm: Option<(Vec<f32>, Vec<f32>)>,
}

/// Samples of an iteration as a group uses them.
struct Samples {
    /// `[(T + 1)·E, A·O]` in the products' kind.
    observation: Tensor,
    /// `[(T + 1)·E, S]` likewise; absent if critics see observations.
    state: Option<Tensor>,
    /// `[M, A·(U + 2)]`: action, old log-probability, advantage.
    actor: Tensor,
    /// `[M, A·2]`: old value (normalised), return.
    critic: Tensor,
    explained_variance: Vec<f64>,
    episode_return: Vec<f64>,
    returns: Tensor,
}

struct Outcome {
    actor_steps: Vec<i64>,
    critic_steps: Vec<i64>,
    /// Mean KL divergence over the last epoch's mini-batches, one an actor.
    last_kl: Vec<f64>,
    report: UpdateReport,
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
            input_norm: config.network.input_norm,
            input_clip: config.network.input_clip,
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

impl Group {
    fn update(
        &mut self,
        job: &Job<'_>,
        actor: &mut Learned,
        critic: &mut Learned,
        mut value_norm: ValueNorm,
        mut trace: Option<&mut Trace>,
    ) -> Result<Outcome, LearnerError> {
        let options = job.options;
        let a = self.actors.len;
        let samples = self.prepare(job, &critic.flat, &value_norm, trace.as_deref_mut());
        let m = (job.dimensions.n_steps * job.dimensions.n_envs * job.shards.len()) as i64;
        for half in [&mut self.actor, &mut self.critic] {
            half.record(trace.is_some());
        }
        let mut sums = Sums::new(a);
        let mut active = vec![true; a];
        let mut last_kl = vec![0.0; a];
        for epoch in 0..options.epochs {
            last_kl.fill(0.0);
            let moments = options.value_norm_beta.map(|beta| {
                value_norm.update(&samples.returns, beta);
                moments(&value_norm)
            });
            let order = Tensor::from_slice(&permutation(
                Address {
                    seed: options.seed,
                    purpose: Purpose::Permutation,
                    iteration: job.iteration as u32,
                    env: epoch as u32,
                    step: 0,
                    index: 0,
                },
                m as usize,
            ))
            .to_device(self.device);
            for mini_batch in 0..options.mini_batches {
                let bound = |i: usize| (i as i64) * m / options.mini_batches as i64;
                let start = bound(mini_batch);
                let rows = order.narrow(0, start, bound(mini_batch + 1) - start);
                let step = (epoch, mini_batch);
                job.work.fetch_add(1, Ordering::Relaxed);
                // Actors that are held back stay where they are; how far that is, only steering asks for.
                let idle = !active.contains(&true) && options.target_kl == 0.0 && trace.is_none();
                if !idle {
                    let kl =
                        self.actor_step(job, actor, &samples, &rows, &mut active, &mut sums, step)?;
                    add(&mut last_kl, kl.iter().map(|kl| kl / options.mini_batches as f64));
                }
                self.critic_step(job, critic, &samples, &rows, moments.as_ref(), &mut sums, step)?;
                if let Some(trace) = trace.as_deref_mut() {
                    let recorded = |half: &Half| {
                        half.recorded.as_ref().map(Tensor::shallow_clone).expect("recorded")
                    };
                    trace.gradients.push((recorded(&self.actor), recorded(&self.critic)));
                    trace.losses.push((sums.last_policy.clone(), sums.last_value.clone()));
                    trace.rows.push(Vec::<i64>::try_from(&rows).expect("row numbers"));
                }
            }
        }
        let parameter = actor.spec.view("log_std", &actor.flat);
        let numbers = |tensor: Tensor| {
            Vec::<f64>::try_from(tensor.to_kind(Kind::Double)).expect("one number an actor")
        };
        let std = options.actor_loss.log_std(&parameter).exp();
        let report = UpdateReport {
            entropy: numbers(options.actor_loss.entropy(&parameter)),
            action_std: numbers(std.mean_dim(&[1i64][..], false, None)),
            explained_variance: samples.explained_variance,
            returns: samples.episode_return,
            ..sums.means()
        };
        Ok(Outcome {
            actor_steps: actor.adam.steps.clone(),
            critic_steps: critic.adam.steps.clone(),
            last_kl,
            report,
        })
    }

    /// Normalises inputs, predicts values, estimates advantages, packs samples.
    fn prepare(
        &mut self,
        job: &Job<'_>,
        critic: &Tensor,
        value_norm: &ValueNorm,
        trace: Option<&mut Trace>,
    ) -> Samples {
        let Dimensions { n_agents, n_steps, n_envs, observation, state, .. } = *job.dimensions;
        let (input, g) = (job.dimensions.actor_input(), job.dimensions.agents_per_actor());
        let (t, n, s) = (n_steps as i64, n_envs as i64, state as i64);
        let (o, own, g) = (input as i64, observation as i64, g as i64);
        let e = n * job.shards.len() as i64;
        let (a, u, m) = (self.actors.len as i64, job.dimensions.actor_output() as i64, t * e);
        let joints = JOINTS_PER_AGENT as i64;
        let float = (Kind::Float, self.device);
        let options = job.options;

        let observations = Tensor::empty([(t + 1) * e, a * o], (self.kind, self.device));
        let states = (!options.own_critic_state)
            .then(|| Tensor::empty([(t + 1) * e, s], (self.kind, self.device)));
        let actor = Tensor::empty([m, a * (u + 2)], float);
        let critic_rows = Tensor::empty([m, a * 2], float);
        let agent_reward = Tensor::empty([a, g, t, e], float);
        let terminated = Tensor::empty([t, e], float);
        let truncated = Tensor::empty([t, e], float);

        let moments_of = |norm: &Option<(Vec<f32>, Vec<f32>)>, rows: Actors, width: usize| {
            norm.as_ref().map(|(mean, inverse_std)| {
                let part = |values: &[f32]| {
                    let all = Tensor::from_slice(values).view([-1, 1, 1, width as i64]);
                    rows.rows(&all).to_device(self.device)
                };
                (part(mean), part(inverse_std))
            })
        };
        let observation_norm = moments_of(&job.observation_norm, self.actors, input);
        let state_norm = moments_of(&job.state_norm, Actors::all(1), state);
        let normalise = |x: &Tensor, norm: &Option<(Tensor, Tensor)>| match options.input_norm {
            InputNormKind::None => x.shallow_clone(),
            InputNormKind::LayerNorm => standardise_input(x),
            InputNormKind::Running => {
                let (mean, inverse_std) = norm.as_ref().expect("running moments");
                let mut x = (x - mean).g_mul_(inverse_std);
                x.clamp_(-options.input_clip, options.input_clip)
            }
        };
        let actor_columns = actor.view([t, e, a, u + 2]);
        for (index, shard) in job.shards.iter().enumerate() {
            let of_actors = |range: &Range<usize>, shape: &[i64]| {
                let shape = [&[(n_agents as i64) / g, g][..], shape].concat();
                self.actors.rows(view(&shard[range.clone()], &shape).tensor())
            };
            let first = index as i64 * n;
            // With one agent an actor, bringing G beside the features moves nothing.
            let seen = of_actors(&job.layout.observation, &[t + 1, n, own]);
            let seen = seen.to_device(self.device).permute([0, 2, 3, 1, 4]);
            let x = normalise(&seen.reshape([a, t + 1, n, o]), &observation_norm);
            let mut slot = observations.view([t + 1, e, a, o]).narrow(1, first, n);
            slot.copy_(&x.permute([1, 2, 0, 3]));
            if let Some(states) = &states {
                let x = view(&shard[job.layout.state.clone()], &[1, t + 1, n, s]);
                let x = normalise(&x.tensor().to_device(self.device), &state_norm);
                let mut slot = states.view([t + 1, e, s]).narrow(1, first, n);
                slot.copy_(&x.squeeze_dim(0));
            }
            let part = actor_columns.narrow(1, first, n);
            let action = of_actors(&job.layout.action, &[t, n, joints]);
            let action = action.permute([2, 3, 0, 1, 4]).reshape([t, n, a, u]);
            part.narrow(3, 0, u).copy_(&action);
            let log_prob = of_actors(&job.layout.log_prob, &[t, n]);
            part.select(3, u).copy_(&over_agents(&log_prob).permute([1, 2, 0]));
            agent_reward.narrow(3, first, n).copy_(&of_actors(&job.layout.reward, &[t, n]));
            for (flags, range) in
                [(&terminated, &job.layout.terminated), (&truncated, &job.layout.truncated)]
            {
                let shard_flags = view(&shard[range.clone()], &[t, n]);
                flags.narrow(1, first, n).copy_(shard_flags.tensor());
            }
        }

        let reward = over_agents(&agent_reward);
        let value = self.values(&observations, states.as_ref(), critic, (t + 1) * e);
        let scaled = if options.value_norm_beta.is_some() {
            let (mean, std) = moments(value_norm);
            &value * std + mean
        } else {
            value.shallow_clone()
        };
        let scaled = scaled.view([a, t + 1, e]);
        let advantage = options.gae.advantages(&reward, &scaled, &terminated, &truncated);
        let returns = &advantage + scaled.narrow(1, 0, t);
        let in_force =
            if options.normalize_advantage { standardise(&advantage) } else { advantage.copy() };
        actor_columns.select(3, u + 1).copy_(&in_force.permute([1, 2, 0]));
        let critic_columns = critic_rows.view([t, e, a, 2]);
        let old = value.view([a, t + 1, e]).narrow(1, 0, t);
        critic_columns.select(3, 0).copy_(&old.permute([1, 2, 0]));
        critic_columns.select(3, 1).copy_(&returns.permute([1, 2, 0]));

        let rows = &[1i64][..];
        let variance =
            |x: &Tensor| x.reshape([a, -1]).to_kind(Kind::Double).var_dim(rows, false, false);
        let explained = 1.0 - variance(&advantage) / variance(&returns).clamp_min(1e-12);
        let episode = agent_reward.view([a * g, t, e]).sum_dim_intlist(rows, false, Kind::Double);
        let episode = episode.mean_dim(rows, false, None);
        if let Some(trace) = trace {
            trace.value = Some(value.view([a, t + 1, e]).copy());
            trace.advantage = Some(advantage.copy());
            trace.returns = Some(returns.copy());
        }
        Samples {
            observation: observations,
            state: states,
            actor,
            critic: critic_rows,
            explained_variance: Vec::try_from(explained).expect("one number an actor"),
            episode_return: Vec::try_from(episode).expect("one number an agent"),
            returns,
        }
    }

    /// The critics' predictions `[A, rows]` for the first `rows` samples.
    fn values(
        &mut self,
        observation: &Tensor,
        state: Option<&Tensor>,
        critic: &Tensor,
        rows: i64,
    ) -> Tensor {
        let a = self.actors.len as i64;
        let value = Tensor::empty([a, rows], (Kind::Float, self.device));
        self.critic.compute.load(critic);
        for chunk in chunks(rows, self.chunk_rows) {
            let len = chunk.end - chunk.start;
            let x = match state {
                Some(state) => shared_input(&state.narrow(0, chunk.start, len), a),
                None => actor_input(&observation.narrow(0, chunk.start, len), a),
            };
            let output = self.critic.compute.forward(&x);
            value.narrow(1, chunk.start, len).copy_(&output.squeeze_dim(1));
        }
        value
    }

    /// A step of the actors on the samples of `rows`; returns how far each had moved before it, as the
    /// divergence KL(old ‖ new).
    #[expect(clippy::too_many_arguments, reason = "one call site; a struct would only rename them")]
    fn actor_step(
        &mut self,
        job: &Job<'_>,
        learned: &mut Learned,
        samples: &Samples,
        rows: &Tensor,
        active: &mut [bool],
        sums: &mut Sums,
        step: (usize, usize),
    ) -> Result<Vec<f64>, LearnerError> {
        let loss = &job.options.actor_loss;
        let a = self.actors.len as i64;
        let u = job.dimensions.actor_output() as i64;
        let batch = rows.size()[0];
        let Half { compute, gradient, .. } = &mut self.actor;
        let _ = gradient.zero_();
        compute.load(&learned.flat);
        let parameter = learned.spec.view("log_std", &learned.flat);
        let options = (Kind::Float, self.device);
        let mut log_std_gradient = Tensor::zeros([a, u], options);
        let mut statistics = Tensor::zeros([a, 3], options);
        for chunk in chunks(batch, self.chunk_rows) {
            let rows = rows.narrow(0, chunk.start, chunk.end - chunk.start);
            let x = actor_input(&samples.observation.index_select(0, &rows), a);
            let columns = columns(&samples.actor.index_select(0, &rows), a);
            let samples = ActorSamples {
                action: columns.narrow(1, 0, u),
                old_log_prob: columns.select(1, u),
                advantage: columns.select(1, u + 1),
            };
            let output = compute.forward(&x);
            let part = loss.gradient(&output, &parameter, &samples, batch);
            compute.backward(&x, &part.output, gradient);
            let _ = log_std_gradient.g_add_(&part.log_std);
            let _ = statistics.g_add_(&part.sums);
        }
        compute.unfold(&learned.flat, gradient);
        let mut slot = learned.spec.view("log_std", gradient);
        slot.copy_(&loss.finish_log_std(&log_std_gradient, &parameter));
        let statistics = Vec::<f32>::try_from((statistics / batch as f64).view([-1]))
            .expect("three numbers an agent");
        let column = |index: usize| statistics.iter().skip(index).step_by(3).map(|&x| f64::from(x));
        let mut kl: Vec<f64> = column(1).collect();
        average_over_networks(&mut kl, learned.spec.n_networks);
        if job.options.max_kl > 0.0 {
            for (active, &kl) in active.iter_mut().zip(&kl) {
                *active &= kl <= job.options.max_kl;
            }
        }
        let rates: Vec<f64> = self.actors.iter().map(|actor| job.actor_lr[actor]).collect();
        let norms = job.options.descent.step(learned, &mut self.actor, &rates, active);
        check(&norms, "actor", self.actors, job.iteration, step)?;
        loss.project(&learned.spec.view("log_std", &learned.flat));
        sums.actor(column(0), column(1), column(2), &norms);
        Ok(kl)
    }

    #[expect(clippy::too_many_arguments, reason = "one call site; a struct would only rename them")]
    fn critic_step(
        &mut self,
        job: &Job<'_>,
        learned: &mut Learned,
        samples: &Samples,
        rows: &Tensor,
        moments: Option<&(Tensor, Tensor)>,
        sums: &mut Sums,
        step: (usize, usize),
    ) -> Result<(), LearnerError> {
        let a = self.actors.len as i64;
        let batch = rows.size()[0];
        let Half { compute, gradient, .. } = &mut self.critic;
        let _ = gradient.zero_();
        compute.load(&learned.flat);
        let mut total = Tensor::zeros([a], (Kind::Float, self.device));
        for chunk in chunks(batch, self.chunk_rows) {
            let rows = rows.narrow(0, chunk.start, chunk.end - chunk.start);
            let x = match &samples.state {
                Some(state) => shared_input(&state.index_select(0, &rows), a),
                None => actor_input(&samples.observation.index_select(0, &rows), a),
            };
            let columns = columns(&samples.critic.index_select(0, &rows), a);
            let old = columns.select(1, 0);
            let target = match moments {
                Some((mean, std)) => (columns.select(1, 1) - mean) / std,
                None => columns.select(1, 1),
            };
            let value = compute.forward(&x).squeeze_dim(1);
            let (d_value, sum) = job.options.critic_loss.gradient(&value, &old, &target, batch);
            compute.backward(&x, &d_value.unsqueeze(1), gradient);
            let _ = total.g_add_(&sum);
        }
        compute.unfold(&learned.flat, gradient);
        let active = vec![true; self.actors.len];
        let rates = vec![job.critic_lr; self.actors.len];
        let norms = job.options.descent.step(learned, &mut self.critic, &rates, &active);
        check(&norms, "critic", self.actors, job.iteration, step)?;
        let losses = Vec::<f32>::try_from(total / batch as f64).expect("one number an agent");
        sums.critic(losses.into_iter().map(f64::from), &norms);
        Ok(())
    }
}

/// Gives every `networks`-th entry their mean.
fn average_over_networks(values: &mut [f64], networks: usize) {
    let each = values.len() / networks;
    for network in 0..networks {
        let of_network = values.iter().skip(network).step_by(networks);
        let mean = of_network.sum::<f64>() / each as f64;
        values.iter_mut().skip(network).step_by(networks).for_each(|value| *value = mean);
    }
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

/// `rows` in parts of nearly equal length, none longer than `limit`.
fn chunks(rows: i64, limit: i64) -> impl Iterator<Item = Range<i64>> {
    let count = if limit >= rows { 1 } else { (rows + limit - 1) / limit };
    (0..count).map(move |i| i * rows / count..(i + 1) * rows / count)
}

/// `[B, A·F]` as the actors' inputs `[A, B, F]`.
fn actor_input(rows: &Tensor, agents: i64) -> Tensor {
    rows.view([rows.size()[0], agents, -1]).transpose(0, 1)
}

/// `[A, G, …]` summed over the agents of each actor.
fn over_agents(x: &Tensor) -> Tensor {
    x.sum_dim_intlist(&[1i64][..], false, Kind::Float)
}

/// `[B, F]` as the same input of all actors, `[A, B, F]`.
fn shared_input(rows: &Tensor, agents: i64) -> Tensor {
    let (b, f) = rows.size2().expect("[B, F]");
    rows.unsqueeze(0).expand([agents, b, f], true)
}

/// `[B, A·C]` as columns `[A, C, B]`, contiguous.
fn columns(rows: &Tensor, agents: i64) -> Tensor {
    rows.view([rows.size()[0], agents, -1]).permute([1, 2, 0]).contiguous()
}

/// Mean and standard deviation of the returns, `[A, 1]` each, in f32.
fn moments(norm: &ValueNorm) -> (Tensor, Tensor) {
    let (mean, std) = norm.mean_and_std();
    let column = |x: Tensor| x.to_kind(Kind::Float).unsqueeze(1);
    (column(mean), column(std))
}

#[cfg(test)]
mod tests;
