//! The steps of a group of actors over the epochs and mini-batches of an iteration.
//!
//! Letters as in [`super`].

use std::sync::atomic::Ordering;

use proto::rng::{Address, Purpose, permutation};
use tch::{Kind, Tensor};

use super::MappoTrace;
use super::group::{Group, GroupUpdate, IterationInputs};
use super::samples::{Samples, chunks, columns, moments, values_by_actor};
use crate::LearnerError;
use crate::loss::{ActorSamples, CriticSamples};
use crate::optimizer_step::{NetworkPart, NetworkPasses, check};
use crate::report::{Sums, UpdateReport, add};
use crate::value_norm::ValueNorm;

impl Group {
    /// Trains `actor` and `critic`, the group's part of the state.
    pub(super) fn update(
        &mut self,
        inputs: &IterationInputs<'_>,
        actor: &mut NetworkPart,
        critic: &mut NetworkPart,
        mut value_norm: ValueNorm,
        mut trace: Option<&mut MappoTrace>,
    ) -> Result<GroupUpdate, LearnerError> {
        let options = inputs.options;
        let a = self.actors.len;
        let samples = self.prepare(inputs, &critic.flat, &value_norm, trace.as_deref_mut());
        let m = (inputs.dimensions.n_steps * inputs.dimensions.n_envs * inputs.shards.len()) as i64;
        for passes in [&mut self.actor, &mut self.critic] {
            passes.record(trace.is_some());
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
                    iteration: inputs.iteration as u32,
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
                inputs.work.fetch_add(1, Ordering::Relaxed);
                // Actors that are held back stay where they are; how far that is, only steering asks for.
                let idle = !active.contains(&true) && options.target_kl == 0.0 && trace.is_none();
                if !idle {
                    let kl = self.actor_step(
                        inputs,
                        actor,
                        &samples,
                        &rows,
                        &mut active,
                        &mut sums,
                        step,
                    )?;
                    add(&mut last_kl, kl.iter().map(|kl| kl / options.mini_batches as f64));
                }
                self.critic_step(
                    inputs,
                    critic,
                    &samples,
                    &rows,
                    moments.as_ref(),
                    &mut sums,
                    step,
                )?;
                if let Some(trace) = trace.as_deref_mut() {
                    let recorded = |passes: &NetworkPasses| {
                        passes.recorded.as_ref().map(Tensor::shallow_clone).expect("recorded")
                    };
                    trace.gradients.push((recorded(&self.actor), recorded(&self.critic)));
                    trace.losses.push((sums.last_policy.clone(), sums.last_value.clone()));
                    trace.rows.push(Vec::<i64>::try_from(&rows).expect("row numbers"));
                }
            }
        }
        let parameter = log_std(actor);
        let numbers = |tensor: Tensor| {
            Vec::<f64>::try_from(tensor.to_kind(Kind::Double)).expect("one number an actor")
        };
        let std = options.actor_loss.log_std(&parameter).exp();
        let report = UpdateReport {
            entropy: numbers(options.actor_loss.entropy(&parameter, self.own.as_ref())),
            action_std: numbers(match &self.own {
                None => std.mean_dim(&[1i64][..], false, None),
                Some(own) => {
                    let sum = |x: &Tensor| x.sum_dim_intlist(&[1i64][..], false, Kind::Float);
                    sum(&(std * own)) / sum(own)
                }
            }),
            explained_variance: samples.explained_variance,
            returns: samples.episode_return,
            ..sums.means()
        };
        Ok(GroupUpdate {
            actor_steps: actor.adam.steps.clone(),
            critic_steps: critic.adam.steps.clone(),
            last_kl,
            report,
        })
    }

    /// A step of the actors on the samples of `rows`; returns how far each had moved before it, as the
    /// divergence KL(old ‖ new).
    #[expect(clippy::too_many_arguments, reason = "one call site; a struct would only rename them")]
    fn actor_step(
        &mut self,
        inputs: &IterationInputs<'_>,
        network: &mut NetworkPart,
        samples: &Samples,
        rows: &Tensor,
        active: &mut [bool],
        sums: &mut Sums,
        step: (usize, usize),
    ) -> Result<Vec<f64>, LearnerError> {
        let loss = &inputs.options.actor_loss;
        let a = self.actors.len as i64;
        let u = inputs.dimensions.actor_output() as i64;
        let batch = rows.size()[0];
        let NetworkPasses { compute, gradient, .. } = &mut self.actor;
        compute.load(&network.flat);
        let parameter = log_std(network);
        let options = (Kind::Float, self.device);
        let mut log_std_gradient = Tensor::zeros([a, u], options);
        let mut statistics = Tensor::zeros([a, 3], options);
        for chunk in chunks(batch, self.chunk_samples) {
            let rows = rows.narrow(0, chunk.start, chunk.end - chunk.start);
            let x = compute.by_network(&samples.observation.index_select(0, &rows));
            let samples = ActorSamples(columns(&samples.actor.index_select(0, &rows), a));
            let output = compute.forward(&x);
            let part = loss.gradient(&output, &parameter, self.own.as_ref(), &samples, batch);
            compute.backward(&x, &part.output, gradient);
            let _ = log_std_gradient.g_add_(&part.log_std);
            let _ = statistics.g_add_(&part.sums);
        }
        compute.unfold(&network.flat, gradient);
        let own = self.own.as_ref();
        let of_actors = loss.finish_log_std(&log_std_gradient, &parameter, own);
        let of_actors = of_actors.view([-1, network.spec.n_networks as i64, u]);
        let mut slot = network.spec.learned("log_std", gradient);
        slot.copy_(&of_actors.sum_dim_intlist(&[0i64][..], false, Kind::Float));
        let statistics = Vec::<f32>::try_from((statistics / batch as f64).view([-1]))
            .expect("three numbers an agent");
        let column = |index: usize| statistics.iter().skip(index).step_by(3).map(|&x| f64::from(x));
        let mut kl: Vec<f64> = column(1).collect();
        average_over_networks(&mut kl, network.spec.n_networks);
        if inputs.options.max_kl > 0.0 {
            for (active, &kl) in active.iter_mut().zip(&kl) {
                *active &= kl <= inputs.options.max_kl;
            }
        }
        let rates: Vec<f64> = self.actors.iter().map(|actor| inputs.actor_lr[actor]).collect();
        let norms = inputs.options.descent.step(network, &mut self.actor, &rates, active);
        check(&norms, "actor", self.actors, inputs.iteration, step)?;
        loss.project(&network.spec.learned("log_std", &network.flat));
        sums.actor(column(0), column(1), column(2), &norms);
        Ok(kl)
    }

    /// A step of the critics on the samples of `rows`; `moments` are those of the returns, if they are normalised.
    #[expect(clippy::too_many_arguments, reason = "one call site; a struct would only rename them")]
    fn critic_step(
        &mut self,
        inputs: &IterationInputs<'_>,
        network: &mut NetworkPart,
        samples: &Samples,
        rows: &Tensor,
        moments: Option<&(Tensor, Tensor)>,
        sums: &mut Sums,
        step: (usize, usize),
    ) -> Result<(), LearnerError> {
        let (a, critics) = (self.actors.len as i64, self.critics.len as i64);
        let batch = rows.size()[0];
        let NetworkPasses { compute, gradient, .. } = &mut self.critic;
        compute.load(&network.flat);
        let mut total = Tensor::zeros([a], (Kind::Float, self.device));
        for chunk in chunks(batch, self.chunk_samples) {
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
            let samples = CriticSamples(columns);
            let (d_value, sum) = inputs.options.critic_loss.gradient(&value, &samples, batch);
            compute.backward(&x, &by_critic(&d_value, critics), gradient);
            let _ = total.g_add_(&sum);
        }
        compute.unfold(&network.flat, gradient);
        let active = vec![true; self.critics.len];
        let rates = vec![inputs.critic_lr; self.critics.len];
        let norms = inputs.options.descent.step(network, &mut self.critic, &rates, &active);
        check(&norms, "critic", self.actors, inputs.iteration, step)?;
        // Those who share a critic share its norm.
        let norms: Vec<f64> = norms.iter().copied().cycle().take(self.actors.len).collect();
        let losses = Vec::<f32>::try_from(total / batch as f64).expect("one number an agent");
        sums.critic(losses.into_iter().map(f64::from), &norms);
        Ok(())
    }
}

/// The logarithms of the deviations `[A, U]`, each actor's that of its network. In the parameters' memory where no network is shared.
fn log_std(actor: &NetworkPart) -> Tensor {
    let learned = actor.spec.learned("log_std", &actor.flat);
    let (networks, actions) = learned.size2().expect("[N, U]");
    let each = actor.spec.rows_per_network();
    learned.unsqueeze(0).expand([each, networks, actions], false).reshape([-1, actions])
}

/// The gradient `[C, A / C, B]` of the mean loss over a critic's agents by what it says, from those `[A, B]` of each agent's loss by its value.
fn by_critic(d_value: &Tensor, critics: i64) -> Tensor {
    let (agents, batch) = d_value.size2().expect("[A, B]");
    let each = agents / critics;
    let d_output = d_value.view([each, critics, batch]).transpose(0, 1).contiguous();
    if each == 1 { d_output } else { d_output / each as f64 }
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
