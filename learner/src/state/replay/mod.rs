//! The replay: what agents saw, did and were paid, in a ring of whole episodes.
//!
//! A slot holds one episode of one environment. It has `T + 1` observations for `T` steps, so what is
//! seen after a step is not stored twice. Critics that see the observations one after the other find
//! them there; another critic state is stored beside. Episodes go in ordered by shard and environment,
//! and the oldest are overwritten, so what stands where depends on nothing but the number of
//! iterations. The ring is part of the training state.
//!
//! Letters: `C` slots, `T` steps of an episode, `A` agents, `O` observation, `S` stored critic state, `U`
//! actions of an agent, `B` samples of a batch.
//!
//! Its bound is `algorithm.maddpg.replay_steps`. At four bytes a number, 100,000 env-steps of preset `paper` are
//! 100 MB in memory and in each checkpoint, of `tuned` 230 MB, and the authors' 500,000 of `release` 560 MB.

use proto::config::{Config, CriticState};
use proto::layout::{BlockLayout, Dimensions};
use proto::rng::Address;
use tch::{Kind, Tensor};

use crate::memory::numbers_mut;

/// The ring.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// Slots.
    pub capacity: usize,
    /// Episodes that were ever put in.
    pub episodes: u64,
    /// `[C, T + 1, A·O]`: before each step, and after the last.
    pub observation: Vec<f32>,
    /// `[C, T + 1, S]`; `S` is 0 if critics see the observations one after the other.
    pub state: Vec<f32>,
    /// `[C, T, A·U]`: actions as they were taken, before the environment clips and scales them.
    pub action: Vec<f32>,
    /// `[C, T, A]`.
    pub reward: Vec<f32>,
    /// `[C, T]`: 1 where what follows the step counts, 0 where the episode ended for good.
    pub future: Vec<f32>,
    n_agents: usize,
    n_actions: usize,
    n_steps: usize,
    n_observation: usize,
    n_state: usize,
    bootstrap_truncated: bool,
}

/// Samples on the processor.
#[derive(Debug)]
pub(crate) struct Batch {
    /// `[B, A·O]`: before the step.
    pub(crate) observation: Tensor,
    /// `[B, A·O]`: after it.
    pub(crate) next_observation: Tensor,
    /// `[B, S]`, if it is stored.
    pub(crate) state: Option<Tensor>,
    /// `[B, S]`, likewise.
    pub(crate) next_state: Option<Tensor>,
    /// `[B, A·U]`: actions as they were taken.
    pub(crate) action: Tensor,
    /// `[B, A]`.
    pub(crate) reward: Tensor,
    /// `[B]`.
    pub(crate) future: Tensor,
}

impl Replay {
    /// An empty ring for `config`.
    pub fn new(config: &Config, dimensions: &Dimensions) -> Self {
        let Dimensions { n_agents: a, n_steps: t, n_actions: u, observation: o, state, .. } =
            *dimensions;
        let s = if config.network.critic_state == CriticState::Concatenated { 0 } else { state };
        let c = config.algorithm.maddpg.replay_steps / t;
        Self {
            capacity: c,
            episodes: 0,
            observation: vec![0.0; c * (t + 1) * a * o],
            state: vec![0.0; c * (t + 1) * s],
            action: vec![0.0; c * t * a * u],
            reward: vec![0.0; c * t * a],
            future: vec![0.0; c * t],
            n_agents: a,
            n_steps: t,
            n_actions: u,
            n_observation: o,
            n_state: s,
            bootstrap_truncated: config.algorithm.bootstrap_truncated,
        }
    }

    /// Steps that it holds.
    pub fn len(&self) -> usize {
        self.episodes.min(self.capacity as u64) as usize * self.n_steps
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The arrays by name, with their shapes.
    pub(crate) fn arrays(&self) -> [(&'static str, Vec<usize>, &[f32]); 5] {
        let Self { capacity: c, n_steps: t, n_agents: a, n_actions: u, n_observation: o, .. } =
            *self;
        let s = self.n_state;
        [
            ("observation", vec![c, t + 1, a * o], &self.observation),
            ("state", vec![c, t + 1, s], &self.state),
            ("action", vec![c, t, a * u], &self.action),
            ("reward", vec![c, t, a], &self.reward),
            ("future", vec![c, t], &self.future),
        ]
    }

    /// The same arrays in the same order, to be overwritten.
    pub(crate) fn arrays_mut(&mut self) -> [(&'static str, &mut [f32]); 5] {
        [
            ("observation", &mut self.observation),
            ("state", &mut self.state),
            ("action", &mut self.action),
            ("reward", &mut self.reward),
            ("future", &mut self.future),
        ]
    }

    /// Takes in the episodes of the blocks of one iteration, ordered by shard.
    pub fn insert(&mut self, dimensions: &Dimensions, shards: &[&[f32]]) {
        let layout = BlockLayout::new(dimensions);
        let n = dimensions.n_envs;
        for shard in shards {
            for env in 0..n {
                let slot = (self.episodes % self.capacity as u64) as usize;
                self.insert_episode(&layout, shard, env, n, slot);
                self.episodes += 1;
            }
        }
    }

    fn insert_episode(
        &mut self,
        layout: &BlockLayout,
        shard: &[f32],
        env: usize,
        n: usize,
        slot: usize,
    ) {
        let Self { n_steps: t, n_agents: a, n_observation: o, n_state: s, .. } = *self;
        let u = self.n_actions;
        for step in 0..=t {
            let row = slot * (t + 1) + step;
            for agent in 0..a {
                let from = ((agent * (t + 1) + step) * n + env) * o;
                self.observation[(row * a + agent) * o..][..o]
                    .copy_from_slice(&shard[layout.observation.start + from..][..o]);
            }
            let from = (step * n + env) * s;
            self.state[row * s..][..s].copy_from_slice(&shard[layout.state.start + from..][..s]);
        }
        for step in 0..t {
            let row = slot * t + step;
            for agent in 0..a {
                let from = (agent * t + step) * n + env;
                self.action[(row * a + agent) * u..][..u]
                    .copy_from_slice(&shard[layout.action.start + from * u..][..u]);
                self.reward[row * a + agent] = shard[layout.reward.start + from];
            }
            let flag = |start: usize| shard[start + step * n + env] != 0.0;
            let ended = flag(layout.terminated.start)
                || (flag(layout.truncated.start) && !self.bootstrap_truncated);
            self.future[row] = f32::from(u8::from(!ended));
        }
    }

    /// `count` rows, each a step of an episode in the ring, uniformly and with replacement. Row r is step
    /// r mod T of slot r div T. `step` of the address counts draws.
    ///
    /// # Panics
    /// If the ring is empty.
    pub fn draw(&self, address: Address, count: usize) -> Vec<usize> {
        assert!(!self.is_empty(), "nothing to sample from");
        let len = self.len() as u64;
        (0..count.div_ceil(4) as u32)
            .flat_map(|step| Address { step, ..address }.words())
            .take(count)
            // Lemire's multiply-shift; its bias of len / 2^32 is far below what training can show.
            .map(|word| ((u64::from(word) * len) >> 32) as usize)
            .collect()
    }

    /// Copies the samples of `rows` into `batch`, which has as many.
    pub(crate) fn gather(&self, rows: &[usize], batch: &mut Batch) {
        let Self { n_steps: t, n_agents: a, n_observation: o, n_state: s, .. } = *self;
        // The row of what is seen before the step; what is seen after it follows.
        let before = |row: usize| row / t * (t + 1) + row % t;
        let after = |row: usize| before(row) + 1;
        let same = |row: usize| row;
        copy_rows(rows, before, &self.observation, a * o, &mut batch.observation);
        copy_rows(rows, after, &self.observation, a * o, &mut batch.next_observation);
        if let (Some(state), Some(next)) = (&mut batch.state, &mut batch.next_state) {
            copy_rows(rows, before, &self.state, s, state);
            copy_rows(rows, after, &self.state, s, next);
        }
        copy_rows(rows, same, &self.action, a * self.n_actions, &mut batch.action);
        copy_rows(rows, same, &self.reward, a, &mut batch.reward);
        copy_rows(rows, same, &self.future, 1, &mut batch.future);
    }

    /// Room for `count` samples.
    pub(crate) fn batch(&self, count: usize) -> Batch {
        let zeros = |width: usize| {
            let shape = [count as i64, width as i64];
            Tensor::zeros(shape, (Kind::Float, tch::Device::Cpu))
        };
        let observation = || zeros(self.n_agents * self.n_observation);
        let state = || (self.n_state > 0).then(|| zeros(self.n_state));
        Batch {
            observation: observation(),
            next_observation: observation(),
            state: state(),
            next_state: state(),
            action: zeros(self.n_agents * self.n_actions),
            reward: zeros(self.n_agents),
            future: zeros(1).squeeze_dim(1),
        }
    }
}

#[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
fn copy_rows(
    rows: &[usize],
    place: impl Fn(usize) -> usize,
    from: &[f32],
    width: usize,
    to: &mut Tensor,
) {
    // SAFETY: `to` is a tensor of a batch, made of zeros with a storage of its own, and the learner has
    // done with it when it is filled again.
    let to = unsafe { numbers_mut::<f32>(to) };
    for (slot, &row) in to.chunks_exact_mut(width).zip(rows) {
        slot.copy_from_slice(&from[place(row) * width..][..width]);
    }
}

#[cfg(test)]
mod tests;
