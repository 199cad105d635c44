//! What an update says about itself.
//!
//! **A learner's sign of life is progress.** While it trains it speaks only when another shard, chunk of
//! samples or mini-batch has begun, so that an update which stands still is found out like a process that does.

/// Losses and diagnostics of an update, one entry an actor.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct UpdateReport {
    /// PPO: clipped surrogate, negated. MADDPG: −Q of the actor's own action. Mean over optimiser steps.
    pub policy_loss: Vec<f64>,
    /// Value loss; mean over optimiser steps.
    pub value_loss: Vec<f64>,
    /// Entropy after the update (nats); 0 of deterministic actors.
    pub entropy: Vec<f64>,
    /// KL estimator k3 (nats); mean over optimiser steps. 0 of deterministic actors.
    pub kl: Vec<f64>,
    /// Share of clipped ratios; mean over optimiser steps. 0 of deterministic actors.
    pub clip_fraction: Vec<f64>,
    /// 1 − Var(target − prediction) / Var(target). PPO: of the returns, before the update. MADDPG: of the
    /// critics' targets, mean over optimiser steps.
    pub explained_variance: Vec<f64>,
    /// Gradient norm of actors before clipping; mean over optimiser steps.
    pub actor_grad_norm: Vec<f64>,
    /// Likewise of critics.
    pub critic_grad_norm: Vec<f64>,
    /// Mean standard deviation of the actions after the update.
    pub action_std: Vec<f64>,
    /// Mean undiscounted return of an episode, one entry an agent.
    pub returns: Vec<f64>,
    /// Learning rates in force.
    pub actor_lr: f64,
    /// Learning rate of critics.
    pub critic_lr: f64,
}

impl UpdateReport {
    /// Takes the entries of groups of actors, of which the n-th of N has actors n, n + N, n + 2N …
    pub(crate) fn interleave(&mut self, mut groups: Vec<Self>) {
        let parts: Vec<_> =
            groups.iter_mut().map(|group| group.lists().map(std::mem::take)).collect();
        for (index, list) in self.lists().into_iter().enumerate() {
            let of_groups: Vec<&[f64]> = parts.iter().map(|part| part[index].as_slice()).collect();
            *list = interleaved(&of_groups);
        }
    }

    fn lists(&mut self) -> [&mut Vec<f64>; 10] {
        [
            &mut self.policy_loss,
            &mut self.value_loss,
            &mut self.entropy,
            &mut self.kl,
            &mut self.clip_fraction,
            &mut self.explained_variance,
            &mut self.actor_grad_norm,
            &mut self.critic_grad_norm,
            &mut self.action_std,
            &mut self.returns,
        ]
    }
}

/// The entries of groups, of which the n-th of N has entries n, n + N, n + 2N … of the result.
pub(crate) fn interleaved<T: Copy, G: AsRef<[T]>>(groups: &[G]) -> Vec<T> {
    let each = groups.first().map_or(0, |group| group.as_ref().len());
    (0..each).flat_map(|index| groups.iter().map(move |group| group.as_ref()[index])).collect()
}

/// Sums of statistics over optimiser steps.
pub(crate) struct Sums {
    /// Of each actor.
    actor_steps: Vec<f64>,
    critic_steps: f64,
    policy: Vec<f64>,
    kl: Vec<f64>,
    clipped: Vec<f64>,
    actor_norm: Vec<f64>,
    value: Vec<f64>,
    critic_norm: Vec<f64>,
    /// Of the last step.
    pub(crate) last_policy: Vec<f64>,
    /// Of the last step.
    pub(crate) last_value: Vec<f64>,
}

impl Sums {
    /// Zeros for so many actors.
    pub(crate) fn new(actors: usize) -> Self {
        let zeros = || vec![0.0; actors];
        Self {
            actor_steps: zeros(),
            critic_steps: 0.0,
            policy: zeros(),
            kl: zeros(),
            clipped: zeros(),
            actor_norm: zeros(),
            value: zeros(),
            critic_norm: zeros(),
            last_policy: zeros(),
            last_value: zeros(),
        }
    }

    /// Adds a step of those actors that `count`: others are held back, and only looked at.
    pub(crate) fn actor(
        &mut self,
        count: &[bool],
        policy: impl Iterator<Item = f64>,
        kl: impl Iterator<Item = f64>,
        clipped: impl Iterator<Item = f64>,
        norms: &[f64],
    ) {
        let counted = |values: Vec<f64>| {
            values.into_iter().zip(count).map(|(value, &count)| if count { value } else { 0.0 })
        };
        self.last_policy = policy.collect();
        add(&mut self.actor_steps, counted(vec![1.0; count.len()]));
        add(&mut self.policy, counted(self.last_policy.clone()));
        add(&mut self.kl, counted(kl.collect()));
        add(&mut self.clipped, counted(clipped.collect()));
        add(&mut self.actor_norm, counted(norms.to_vec()));
    }

    /// Adds a step of the critics.
    pub(crate) fn critic(&mut self, value: impl Iterator<Item = f64>, norms: &[f64]) {
        self.critic_steps += 1.0;
        self.last_value = value.collect();
        add(&mut self.value, self.last_value.iter().copied());
        add(&mut self.critic_norm, norms.iter().copied());
    }

    /// The means; zeros if there were no steps.
    pub(crate) fn means(self) -> UpdateReport {
        let mean = |sums: Vec<f64>, steps: &[f64]| {
            sums.iter().zip(steps).map(|(sum, steps)| sum / steps.max(1.0)).collect()
        };
        let actor = self.actor_steps;
        let critic = vec![self.critic_steps; actor.len()];
        UpdateReport {
            policy_loss: mean(self.policy, &actor),
            kl: mean(self.kl, &actor),
            clip_fraction: mean(self.clipped, &actor),
            actor_grad_norm: mean(self.actor_norm, &actor),
            value_loss: mean(self.value, &critic),
            critic_grad_norm: mean(self.critic_norm, &critic),
            ..UpdateReport::default()
        }
    }
}

/// Adds number by number.
pub(crate) fn add(sums: &mut [f64], values: impl Iterator<Item = f64>) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_of_who_is_held_back_are_not_among_those_that_are_averaged() {
        let mut sums = Sums::new(2);
        for (count, x) in [([true, true], 1.0), ([true, false], 3.0)] {
            let both = || std::iter::repeat_n(x, 2);
            sums.actor(&count, both(), both(), both(), &[x, x]);
        }
        sums.critic(std::iter::repeat_n(5.0, 2), &[7.0, 7.0]);
        let report = sums.means();
        assert_eq!([&report.policy_loss, &report.kl, &report.clip_fraction], [&[2.0, 1.0]; 3]);
        assert_eq!(report.actor_grad_norm, [2.0, 1.0]);
        assert_eq!((report.value_loss, report.critic_grad_norm), (vec![5.0; 2], vec![7.0; 2]));
    }
}
