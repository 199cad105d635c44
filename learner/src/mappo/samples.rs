//! The samples of an iteration as a group of actors learns from them: gathered from the blocks, normalised, with
//! predicted values and advantages.
//!
//! Letters as in [`super`].

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use proto::layout::Dimensions;
use tch::{Kind, Tensor};

use super::MappoTrace;
use super::group::{Group, IterationInputs};
use super::inputs::Inputs;
use crate::actors::Actors;
use crate::gae::standardise;
use crate::memory::view;
use crate::value_norm::ValueNorm;

/// Samples of an iteration as a group uses them.
pub(super) struct Samples {
    /// `[(T + 1)·E, A·O]` in the products' kind.
    pub(super) observation: Tensor,
    /// `[(T + 1)·E, S]` likewise; absent if critics see observations.
    pub(super) state: Option<Tensor>,
    /// `[M, A·(U + 2)]`: action, old log-probability, advantage.
    pub(super) actor: Tensor,
    /// `[M, A·2]`: old value (normalised), return.
    pub(super) critic: Tensor,
    pub(super) explained_variance: Vec<f64>,
    pub(super) episode_return: Vec<f64>,
    pub(super) returns: Tensor,
}

impl Group {
    /// Normalises inputs, predicts values, estimates advantages, packs samples.
    #[expect(unsafe_code, reason = "only here is it known how long a shard's tensors live")]
    pub(super) fn prepare(
        &mut self,
        job: &IterationInputs<'_>,
        critic: &Tensor,
        value_norm: &ValueNorm,
        trace: Option<&mut MappoTrace>,
    ) -> Samples {
        let Dimensions { n_agents, n_steps, n_envs, observation, state, .. } = *job.dimensions;
        let agents = job.dimensions.agents_per_actor();
        let (t, n, g) = (n_steps as i64, n_envs as i64, agents as i64);
        let e = n * job.shards.len() as i64;
        let (a, u, m) = (self.actors.len as i64, job.dimensions.actor_output() as i64, t * e);
        let joints = job.dimensions.n_actions as i64;
        let float = (Kind::Float, self.device);
        let options = job.options;

        let seen = Inputs {
            actors: self.actors,
            size: [agents, n_steps + 1, n_envs, observation],
            normalisation: options.normalisation,
            moments: job.observation_norm.as_ref(),
        };
        let known = Inputs {
            actors: Actors::all(1),
            size: [1, n_steps + 1, n_envs, state],
            moments: job.state_norm.as_ref(),
            ..seen
        };
        let room = |inputs: &Inputs<'_>| inputs.rows(e as usize, (self.kind, self.device));
        let mut observations = room(&seen);
        let mut states = (!options.own_critic_state).then(|| room(&known));
        let in_passes = self.plain.is_some() && options.normalisation.is_of_each_number();
        let put = |inputs: &Inputs<'_>, block: &[f32], first: usize, rows: &mut Tensor| {
            if in_passes {
                inputs.put(block, first, rows);
            } else {
                inputs.put_by_operations(block, first, rows);
            }
        };
        let actor = Tensor::empty([m, a * (u + 2)], float);
        let critic_rows = Tensor::empty([m, a * 2], float);
        let agent_reward = Tensor::empty([a, g, t, e], float);
        let terminated = Tensor::empty([t, e], float);
        let truncated = Tensor::empty([t, e], float);

        let actor_columns = actor.view([t, e, a, u + 2]);
        for (index, shard) in job.shards.iter().enumerate() {
            job.work.fetch_add(1, Ordering::Relaxed);
            let in_place = |range: &Range<usize>, shape: &[i64]| {
                // SAFETY: `job` borrows the shards for longer than this function runs. What is made of
                // one is read, copied into the tensors above, and gone at the end of this turn.
                unsafe { view(&shard[range.clone()], shape) }
            };
            let of_actors = |range: &Range<usize>, shape: &[i64]| {
                let shape = [&[(n_agents as i64) / g, g][..], shape].concat();
                self.actors.rows(&in_place(range, &shape))
            };
            let first = index as i64 * n;
            put(&seen, &shard[job.layout.observation.clone()], index * n_envs, &mut observations);
            if let Some(states) = &mut states {
                put(&known, &shard[job.layout.state.clone()], index * n_envs, states);
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
                flags.narrow(1, first, n).copy_(&in_place(range, &[t, n]));
            }
        }

        let reward = over_agents(&agent_reward);
        let seen = (&observations, states.as_ref());
        let value = self.values(seen, critic, (t + 1) * e, job.work);
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
        (observation, state): (&Tensor, Option<&Tensor>),
        critic: &Tensor,
        rows: i64,
        work: &AtomicU64,
    ) -> Tensor {
        let value = Tensor::empty([self.actors.len as i64, rows], (Kind::Float, self.device));
        let compute = &mut self.critic.compute;
        compute.load(critic);
        for chunk in chunks(rows, self.chunk_samples) {
            work.fetch_add(1, Ordering::Relaxed);
            let len = chunk.end - chunk.start;
            let x = match state {
                Some(state) => compute.for_all(&state.narrow(0, chunk.start, len)),
                None => compute.by_network(&observation.narrow(0, chunk.start, len)),
            };
            value.narrow(1, chunk.start, len).copy_(&values_by_actor(&compute.forward(&x)));
        }
        value
    }
}

/// `rows` in parts of nearly equal length, none longer than `limit`.
pub(super) fn chunks(rows: i64, limit: i64) -> impl Iterator<Item = Range<i64>> {
    let count = if limit >= rows { 1 } else { (rows + limit - 1) / limit };
    (0..count).map(move |i| i * rows / count..(i + 1) * rows / count)
}

/// `[A, G, …]` summed over the agents of each actor.
fn over_agents(x: &Tensor) -> Tensor {
    x.sum_dim_intlist(&[1i64][..], false, Kind::Float)
}

/// The values `[A, B]` of what critics say, `[C, A / C, B]`. Critic c is that of the actors c, c + C, c + 2C …
pub(super) fn values_by_actor(output: &Tensor) -> Tensor {
    let batch = output.size()[2];
    output.transpose(0, 1).reshape([-1, batch])
}

/// `[B, A·C]` as columns `[A, C, B]`, contiguous.
pub(super) fn columns(rows: &Tensor, agents: i64) -> Tensor {
    rows.view([rows.size()[0], agents, -1]).permute([1, 2, 0]).contiguous()
}

/// Mean and standard deviation of the returns, `[A, 1]` each, in f32.
pub(super) fn moments(norm: &ValueNorm) -> (Tensor, Tensor) {
    let (mean, std) = norm.mean_and_std();
    let column = |x: Tensor| x.to_kind(Kind::Float).unsqueeze(1);
    (column(mean), column(std))
}
