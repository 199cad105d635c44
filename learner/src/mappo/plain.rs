//! Gradients of a mini-batch on a CPU: samples are gathered, and losses computed, in plain Rust.
//!
//! A step is a few milliseconds, and an operation of libtorch costs a microsecond or more whatever it computes. Of such operations only a handful is left.
//!
//! Letters as in [`super`].

use std::sync::atomic::Ordering;

use tch::{Kind, Tensor};

use super::gradients::MiniBatch;
use super::group::Group;
use super::samples::chunks;
use crate::loss::STATISTICS;
use crate::memory::{Element, numbers, numbers_mut, sum_over_rows};
use crate::number::Bf16;
use crate::optimizer_step::{NetworkPart, NetworkPasses};

impl Group {
    /// [`Group::actor_gradient`] on a CPU.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(super) fn plain_actor_gradient(
        &mut self,
        network: &NetworkPart,
        batch: &MiniBatch<'_>,
    ) -> Vec<f32> {
        let MiniBatch { options, samples, rows, work, .. } = *batch;
        let loss = &options.actor_loss;
        let (a, n) = (self.actors.len, network.spec.n_networks);
        let u = network.spec.output as usize;
        let row = network.spec.len as usize;
        let of_log_std = network.spec.get("log_std").columns();
        // SAFETY: parameters are filled, and nobody writes them while a gradient is computed.
        let flat: &[f32] = unsafe { numbers(&network.flat) };
        let parameter: Vec<f32> = (0..a)
            .flat_map(|actor| &flat[actor % n * row..][of_log_std.clone()])
            .copied()
            .collect();
        // SAFETY: filled when the group was made, and never written.
        let own: Option<&[f32]> = self.own.as_ref().map(|own| unsafe { numbers(own) });
        let room = self.plain.as_mut().expect("on a CPU");
        let NetworkPasses { compute, gradient, .. } = &mut self.actor;
        let mut total = vec![0.0; a * (STATISTICS + u)];
        for range in chunks(rows.len() as i64, self.chunk_samples) {
            work.fetch_add(1, Ordering::Relaxed);
            let part = &rows[range.start as usize..range.end as usize];
            let x = compute.by_network(gather(&samples.observation, part, &mut room.seen[0]));
            gather_columns(&samples.actor, part, &mut room.columns);
            let output = compute.forward(&x);
            let (d_output, sums) = loss.gradient_in_passes(
                &mut room.actor,
                &output,
                &parameter,
                own,
                &room.columns,
                rows.len(),
            );
            compute.backward(&x, d_output, gradient);
            total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
        }
        let each = |index: usize| {
            let (actor, action) = (index / u, index % u);
            let by_log_std = total[actor * (STATISTICS + u) + STATISTICS + action];
            loss.finish_one_log_std(by_log_std, parameter[index], own.map(|own| own[index]))
        };
        let of_actors: Vec<f32> = (0..a * u).map(each).collect();
        let of_networks = sum_over_rows(&of_actors, n * u);
        let mut gradient = gradient.shallow_clone();
        // SAFETY: made of zeros by the passes' owner; no tensor of the passes lies there, and who records it does not read it meanwhile.
        let gradient: &mut [f32] = unsafe { numbers_mut(&mut gradient) };
        let slots = gradient.chunks_exact_mut(row).zip(of_networks.chunks_exact(u));
        slots.for_each(|(row, sums)| row[of_log_std.clone()].copy_from_slice(sums));
        let of_actors = total.chunks_exact(STATISTICS + u);
        of_actors.flat_map(|sums| &sums[..STATISTICS]).map(|sum| sum / rows.len() as f32).collect()
    }

    /// [`Group::critic_gradient`] on a CPU.
    #[expect(unsafe_code, reason = "only here is it known that nobody writes meanwhile")]
    pub(super) fn plain_critic_gradient(&mut self, batch: &MiniBatch<'_>) -> Vec<f32> {
        let MiniBatch { options, samples, rows, moments, work, .. } = *batch;
        let room = self.plain.as_mut().expect("on a CPU");
        let NetworkPasses { compute, gradient, .. } = &mut self.critic;
        let mut total = vec![0.0; self.actors.len];
        for range in chunks(rows.len() as i64, self.chunk_samples) {
            work.fetch_add(1, Ordering::Relaxed);
            let part = &rows[range.start as usize..range.end as usize];
            let x = match &samples.state {
                Some(state) => compute.for_all(gather(state, part, &mut room.seen[1])),
                None => compute.by_network(gather(&samples.observation, part, &mut room.seen[1])),
            };
            gather_columns(&samples.critic, part, &mut room.columns);
            if let Some((mean, std)) = moments {
                // SAFETY: made by the update for itself, and not written after.
                let (mean, std): (&[f32], &[f32]) = unsafe { (numbers(mean), numbers(std)) };
                let agents = room.columns.chunks_exact_mut(2 * part.len());
                for ((columns, mean), std) in agents.zip(mean).zip(std) {
                    for target in &mut columns[part.len()..] {
                        *target = (*target - mean) / std;
                    }
                }
            }
            let output = compute.forward(&x);
            let (d_output, sums) = options.critic_loss.gradient_in_a_pass(
                &mut room.critic,
                &output,
                &room.columns,
                rows.len(),
            );
            compute.backward(&x, d_output, gradient);
            total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
        }
        total.iter().map(|total| total / rows.len() as f32).collect()
    }
}

/// Rows of `source` `[M, F]`, in memory that is kept: `[B, F]`.
fn gather<'t>(source: &Tensor, rows: &[i64], kept: &'t mut Option<Tensor>) -> &'t Tensor {
    let (_, width) = source.size2().expect("[M, F]");
    let size = [rows.len() as i64, width];
    if kept.as_ref().is_none_or(|kept| kept.size() != size || kept.kind() != source.kind()) {
        *kept = Some(Tensor::zeros(size, (source.kind(), source.device())));
    }
    let out = kept.as_mut().expect("made above");
    match source.kind() {
        Kind::BFloat16 => copy_rows::<Bf16>(source, rows, out),
        _ => copy_rows::<f32>(source, rows, out),
    }
    out
}

#[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
fn copy_rows<T: Element>(source: &Tensor, rows: &[i64], out: &mut Tensor) {
    let width = source.size()[1] as usize;
    // SAFETY: samples are filled and not written after; `out` was made of zeros by `gather`, and the chunk that had it before is done.
    let (source, out): (&[T], &mut [T]) = unsafe { (numbers(source), numbers_mut(out)) };
    for (out, &row) in out.chunks_exact_mut(width).zip(rows) {
        out.copy_from_slice(&source[row as usize * width..][..width]);
    }
}

/// Rows of `source` `[M, A·C]` as columns `[A, C, B]`.
#[expect(unsafe_code, reason = "only here is it known that nobody writes meanwhile")]
fn gather_columns(source: &Tensor, rows: &[i64], out: &mut Vec<f32>) {
    let width = source.size()[1] as usize;
    // SAFETY: samples are filled and not written after.
    let source: &[f32] = unsafe { numbers(source) };
    out.resize(width * rows.len(), 0.0);
    for (i, &row) in rows.iter().enumerate() {
        let row = &source[row as usize * width..][..width];
        for (out, &x) in out.chunks_exact_mut(rows.len()).zip(row) {
            out[i] = x;
        }
    }
}
