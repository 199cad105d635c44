//! Gradients of a mini-batch: in plain Rust on a CPU (`plain.rs`), or operation by operation of libtorch, on a GPU and as the twin that tests the other.
//!
//! Letters as in [`super`].

use std::sync::atomic::{AtomicU64, Ordering};

use tch::{Kind, Tensor};

use super::group::Group;
use super::options::Options;
use super::samples::{Samples, chunks, columns, values_by_actor};
use crate::loss::{ActorSamples, CriticSamples, STATISTICS};
use crate::optimizer_step::{NetworkPart, NetworkPasses};

/// What a step learns from.
pub(super) struct MiniBatch<'a> {
    pub(super) options: &'a Options,
    pub(super) samples: &'a Samples,
    /// Which samples: at least one.
    pub(super) rows: &'a [i64],
    /// Those of the returns, if they are normalised: mean and deviation, `[A, 1]` each.
    pub(super) moments: Option<&'a (Tensor, Tensor)>,
    /// Epoch and mini-batch.
    pub(super) step: (usize, usize),
    /// Counts chunks.
    pub(super) work: &'a AtomicU64,
}

impl MiniBatch<'_> {
    /// Where it is in an iteration, in words.
    pub(super) fn place(&self) -> String {
        let (epoch, mini_batch) = self.step;
        format!("epoch {epoch}, mini-batch {mini_batch}")
    }
}

impl Group {
    /// Writes the actors' gradient; returns statistics `[A, 3]`: means over the mini-batch of the surrogate loss, of the divergence and of the clipped ratios.
    pub(super) fn actor_gradient(
        &mut self,
        network: &NetworkPart,
        batch: &MiniBatch<'_>,
    ) -> Vec<f32> {
        self.actor.compute.load(&network.flat);
        let statistics = if self.plain.is_some() {
            self.plain_actor_gradient(network, batch)
        } else {
            self.actor_gradient_by_operations(network, batch)
        };
        self.actor.compute.unfold(&network.flat, &self.actor.gradient);
        statistics
    }

    /// Writes the critics' gradient; returns the mean losses `[A]`.
    pub(super) fn critic_gradient(
        &mut self,
        network: &NetworkPart,
        batch: &MiniBatch<'_>,
    ) -> Vec<f32> {
        self.critic.compute.load(&network.flat);
        let losses = if self.plain.is_some() {
            self.plain_critic_gradient(batch)
        } else {
            self.critic_gradient_by_operations(batch)
        };
        self.critic.compute.unfold(&network.flat, &self.critic.gradient);
        losses
    }

    fn actor_gradient_by_operations(
        &mut self,
        network: &NetworkPart,
        batch: &MiniBatch<'_>,
    ) -> Vec<f32> {
        let MiniBatch { options, samples, rows, work, .. } = *batch;
        let loss = &options.actor_loss;
        let a = self.actors.len as i64;
        let u = network.spec.output;
        let len = rows.len() as i64;
        let NetworkPasses { compute, gradient, .. } = &mut self.actor;
        let parameter = network.spec.log_std(&network.flat);
        let zeros = |width| Tensor::zeros([a, width], (Kind::Float, self.device));
        let (mut log_std_gradient, mut statistics) = (zeros(u), zeros(STATISTICS as i64));
        let rows = Tensor::from_slice(rows).to_device(self.device);
        for chunk in chunks(len, self.chunk_samples) {
            work.fetch_add(1, Ordering::Relaxed);
            let rows = rows.narrow(0, chunk.start, chunk.end - chunk.start);
            let x = compute.by_network(&samples.observation.index_select(0, &rows));
            let samples = ActorSamples(columns(&samples.actor.index_select(0, &rows), a));
            let output = compute.forward(&x);
            let part = loss.gradient(&output, &parameter, self.own.as_ref(), &samples, len);
            compute.backward(&x, &part.output, gradient);
            let _ = log_std_gradient.g_add_(&part.log_std);
            let _ = statistics.g_add_(&part.sums);
        }
        let of_actors = loss.finish_log_std(&log_std_gradient, &parameter, self.own.as_ref());
        let of_actors = of_actors.view([-1, network.spec.n_networks as i64, u]);
        let mut slot = network.spec.learned("log_std", gradient);
        slot.copy_(&of_actors.sum_dim_intlist(&[0i64][..], false, Kind::Float));
        Vec::try_from((statistics / len as f64).view([-1])).expect("three numbers an agent")
    }

    fn critic_gradient_by_operations(&mut self, batch: &MiniBatch<'_>) -> Vec<f32> {
        let MiniBatch { options, samples, rows, moments, work, .. } = *batch;
        let (a, critics) = (self.actors.len as i64, self.critics.len as i64);
        let len = rows.len() as i64;
        let NetworkPasses { compute, gradient, .. } = &mut self.critic;
        let mut total = Tensor::zeros([a], (Kind::Float, self.device));
        let rows = Tensor::from_slice(rows).to_device(self.device);
        for chunk in chunks(len, self.chunk_samples) {
            work.fetch_add(1, Ordering::Relaxed);
            let rows = rows.narrow(0, chunk.start, chunk.end - chunk.start);
            let x = match &samples.state {
                Some(state) => compute.for_all(&state.index_select(0, &rows)),
                None => compute.by_network(&samples.observation.index_select(0, &rows)),
            };
            let columns = columns(&samples.critic.index_select(0, &rows), a);
            if let Some((mean, std)) = moments {
                let _ = columns.select(1, 1).g_sub_(mean).g_div_(std);
            }
            let value = values_by_actor(&compute.forward(&x));
            let (d_value, sum) = options.critic_loss.gradient(&value, &CriticSamples(columns), len);
            compute.backward(&x, &by_critic(&d_value, critics), gradient);
            let _ = total.g_add_(&sum);
        }
        Vec::try_from(total / len as f64).expect("one number an agent")
    }
}

/// The gradient `[C, A / C, B]` of the mean loss over a critic's agents by what it says, from those `[A, B]` of each agent's loss by its value.
fn by_critic(d_value: &Tensor, critics: i64) -> Tensor {
    let (agents, batch) = d_value.size2().expect("[A, B]");
    let each = agents / critics;
    let d_output = d_value.view([each, critics, batch]).transpose(0, 1).contiguous();
    if each == 1 { d_output } else { d_output / each as f64 }
}
