//! The steps of a group of actors over the epochs and mini-batches of an iteration.
//!
//! Letters as in [`super`].

use proto::rng::{Address, Purpose, permutation};
use tch::{Kind, Tensor};

use super::MappoTrace;
use super::gradients::MiniBatch;
use super::group::{Group, GroupUpdate, IterationInputs};
use super::samples::moments;
use crate::LearnerError;
use crate::loss::STATISTICS;
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
        let m = inputs.dimensions.n_steps * inputs.dimensions.n_envs * inputs.shards.len();
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
            let order = permutation(
                Address {
                    seed: options.seed,
                    purpose: Purpose::Permutation,
                    iteration: inputs.iteration as u32,
                    env: epoch as u32,
                    step: 0,
                    index: 0,
                },
                m,
            );
            for mini_batch in 0..options.mini_batches {
                let bound = |i: usize| i * m / options.mini_batches;
                let rows = &order[bound(mini_batch)..bound(mini_batch + 1)];
                debug_assert!(!rows.is_empty(), "there are more mini-batches than samples");
                let batch = MiniBatch {
                    options,
                    samples: &samples,
                    rows,
                    moments: moments.as_ref(),
                    step: (epoch, mini_batch),
                    work: inputs.work,
                };
                // Actors that are held back stay where they are; how far that is, only steering asks for.
                let idle = !active.contains(&true) && options.target_kl == 0.0 && trace.is_none();
                if !idle {
                    let kl = self.actor_step(inputs, actor, &batch, &mut active, &mut sums)?;
                    add(&mut last_kl, kl.iter().map(|kl| kl / options.mini_batches as f64));
                }
                self.critic_step(inputs, critic, &batch, &mut sums)?;
                if let Some(trace) = trace.as_deref_mut() {
                    let recorded = |passes: &NetworkPasses| {
                        passes.recorded.as_ref().map(Tensor::shallow_clone).expect("recorded")
                    };
                    trace.gradients.push((recorded(&self.actor), recorded(&self.critic)));
                    trace.losses.push((sums.last_policy.clone(), sums.last_value.clone()));
                    trace.rows.push(rows.to_vec());
                }
            }
        }
        let parameter = actor.spec.log_std(&actor.flat);
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

    /// A step of the actors on a mini-batch; returns how far each had moved before it, as the
    /// divergence KL(old ‖ new).
    fn actor_step(
        &mut self,
        inputs: &IterationInputs<'_>,
        network: &mut NetworkPart,
        batch: &MiniBatch<'_>,
        active: &mut [bool],
        sums: &mut Sums,
    ) -> Result<Vec<f64>, LearnerError> {
        let statistics = self.actor_gradient(network, batch);
        let column =
            |index: usize| statistics.iter().skip(index).step_by(STATISTICS).map(|&x| f64::from(x));
        let mut kl: Vec<f64> = column(1).collect();
        average_over_networks(&mut kl, network.spec.n_networks);
        // The step in which an actor is found to have gone too far is the last that counts.
        let count = active.to_vec();
        if inputs.options.max_kl > 0.0 {
            for (active, &kl) in active.iter_mut().zip(&kl) {
                *active &= kl <= inputs.options.max_kl;
            }
        }
        let rates: Vec<f64> = self.actors.iter().map(|actor| inputs.actor_lr[actor]).collect();
        let norms = inputs.options.descent.step(network, &mut self.actor, &rates, active);
        check(&norms, "actor", self.actors, inputs.iteration, || batch.place())?;
        inputs.options.actor_loss.project(&network.spec.learned("log_std", &network.flat));
        sums.actor(&count, column(0), column(1), column(2), &norms);
        Ok(kl)
    }

    /// A step of the critics on a mini-batch.
    fn critic_step(
        &mut self,
        inputs: &IterationInputs<'_>,
        network: &mut NetworkPart,
        batch: &MiniBatch<'_>,
        sums: &mut Sums,
    ) -> Result<(), LearnerError> {
        let losses = self.critic_gradient(network, batch);
        let active = vec![true; self.critics.len];
        let rates = vec![inputs.critic_lr; self.critics.len];
        let norms = inputs.options.descent.step(network, &mut self.critic, &rates, &active);
        check(&norms, "critic", self.actors, inputs.iteration, || batch.place())?;
        // Those who share a critic share its norm.
        let norms: Vec<f64> = norms.iter().copied().cycle().take(self.actors.len).collect();
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
