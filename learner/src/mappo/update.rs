//! The update with its buffers: groups of actors, which threads take one after another.

use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

use proto::config::Config;
use proto::layout::{BlockLayout, Dimensions};
use rayon::ThreadPool;
use tch::{Device, Tensor};

use super::MappoTrace;
use super::group::{Group, GroupUpdate, IterationInputs};
use super::options::Options;
use super::room::Room;
use crate::LearnerError;
use crate::actors::Actors;
use crate::input_norm::InputNorm;
use crate::mlp::Threads;
use crate::optimizer_step::{NetworkPasses, NetworkRows, learning_rates};
use crate::report::{UpdateReport, interleaved};
use crate::state::{NetworkState, TrainingState};
use crate::threads::KeptThreads;
use crate::update::Update;

/// Samples of each actor that go through the networks at once on a CPU. Activations of so many fit in the cache; of
/// fewer, the gradients of weights are summed more often.
const CHUNK_SAMPLES: i64 = 1600;

/// The update with its buffers.
#[derive(Debug)]
pub struct Mappo {
    pub(super) config: Config,
    dimensions: Dimensions,
    pub(super) layout: BlockLayout,
    options: Options,
    pub(super) groups: Vec<Group>,
    /// Those that compute groups beside the caller's.
    others: Option<KeptThreads>,
    /// With how many of libtorch's threads a group is computed.
    threads: usize,
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
        let device = state.device();
        let kind = state.arithmetic.kind();
        let threads = config.run.learner_threads;
        let at_once = threads.min(n_groups);
        let each = if threads / at_once == 1 { Threads::One } else { Threads::Several };
        let groups = (0..n_groups)
            .map(|first| {
                let len = dimensions.n_actors / n_groups;
                let actors = Actors { first, step: n_groups, len };
                let n_critics = state.critic.spec.rows / n_groups;
                let critics = Actors { len: n_critics, ..actors };
                let passes = |network: &NetworkState, rows: &Actors| {
                    NetworkPasses::new(config, network, rows, kind, device, each)
                };
                let own = dimensions.actions_with_joint().map(|flags| {
                    let shape = [dimensions.n_actors as i64, dimensions.actor_output() as i64];
                    actors.rows(&Tensor::from_slice(&flags).view(shape)).copy().to_device(device)
                });
                Group {
                    own,
                    actor: passes(&state.actor, &actors),
                    critic: passes(&state.critic, &critics),
                    critics,
                    plain: (device == Device::Cpu).then(Room::default),
                    chunk_samples: if device.is_cuda() { i64::MAX } else { CHUNK_SAMPLES },
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
            options: Options::new(config),
            groups,
            others: (at_once > 1).then(|| KeptThreads::new("update", at_once - 1)),
            threads: threads / at_once,
            work: Arc::default(),
        }
    }
}

impl Update for Mappo {
    type Trace = MappoTrace;

    fn work(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.work)
    }

    /// Only with one group something can be recorded.
    fn update_traced(
        &mut self,
        state: &mut TrainingState,
        shards: &[&[f32]],
        trace: Option<&mut MappoTrace>,
    ) -> Result<UpdateReport, LearnerError> {
        assert!(trace.is_none() || self.groups.len() == 1, "one group can be traced");
        state.begin_update(&self.dimensions, shards);
        let (actor_lr, critic_lr) = learning_rates(&self.config, state.env_steps);
        let inputs = IterationInputs {
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
        let threads = (self.others.as_deref(), self.threads);
        let outcomes = run_groups(&mut self.groups, state, &inputs, threads, trace);
        let actor_lr = inputs.actor_lr.iter().sum::<f64>() / inputs.actor_lr.len() as f64;
        let mut report = UpdateReport { actor_lr, critic_lr, ..UpdateReport::default() };
        let (mut steps, mut parts) = ((Vec::new(), Vec::new()), Vec::new());
        let mut last_kl = Vec::new();
        for outcome in outcomes {
            let GroupUpdate { actor_steps, critic_steps, last_kl: kl, report: part } = outcome?;
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
        state.end_update(&self.dimensions, shards, self.config.steps_per_iteration())?;
        Ok(report)
    }
}

/// Runs all groups on the caller's thread and `others`, a group with so many `threads` of libtorch's; outcomes are in the groups' order.
fn run_groups(
    groups: &mut [Group],
    state: &TrainingState,
    inputs: &IterationInputs<'_>,
    (others, threads): (Option<&ThreadPool>, usize),
    trace: Option<&mut MappoTrace>,
) -> Vec<Result<GroupUpdate, LearnerError>> {
    let mut outcomes: Vec<_> = groups.iter().map(|_| None).collect();
    let waiting: Vec<_> = groups
        .iter_mut()
        .zip(&mut outcomes)
        .map(|(group, outcome)| {
            let actors = group.actors;
            let learned = (
                NetworkRows::new(&state.actor, actors),
                NetworkRows::new(&state.critic, group.critics),
            );
            let norm = state.value_norm.part(&actors);
            (group, learned, norm, outcome)
        })
        .collect();
    let waiting = Mutex::new(waiting.into_iter());
    let work = |mut trace: Option<&mut MappoTrace>| {
        tch::set_num_threads(threads as i32);
        loop {
            let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).next();
            let Some((group, (actor, critic), norm, outcome)) = next else { break };
            let trace = trace.as_deref_mut();
            let result = tch::no_grad(|| {
                let mut actor = actor.take(&mut group.actor);
                let mut critic = critic.take(&mut group.critic);
                let result = group.update(inputs, &mut actor, &mut critic, norm, trace);
                actor.put_back();
                critic.put_back();
                result
            });
            *outcome = Some(result);
        }
    };
    match others {
        None => work(trace),
        Some(others) => others.in_place_scope(|scope| {
            for _ in 0..others.current_num_threads() {
                scope.spawn(|_| work(None));
            }
            work(trace);
        }),
    }
    outcomes.into_iter().map(|outcome| outcome.expect("every group was computed")).collect()
}

/// An actor's share of the scheduled learning rate after an iteration in which it moved by `kl`.
///
/// The factors are those of the adaptive penalty of Schulman et al. 2017, section 4, turned on the learning
/// rate as Rudin et al. 2021 do ("Learning to walk in minutes using massively parallel deep reinforcement
/// learning", appendix).
pub(super) fn steered(rate: f64, kl: f64, target: f64) -> f64 {
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
