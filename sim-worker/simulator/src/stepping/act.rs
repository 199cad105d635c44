//! What a policy would do.

use proto::layout::Dimensions;

use crate::executor::{self, Executor};
use crate::policy::{Policy, Scratch};
use crate::rollout::{World, write_rows};
use crate::scalar::{Backend, LANES, LaneFn, Real, dispatch_for};

/// Environments that a thread takes at a time.
const CHUNK: usize = 4 * LANES;

/// Why there are no actions.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ActError {
    /// An array of another size.
    #[error("{what} has {found} numbers, expected {expected}")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its numbers.
        found: usize,
        /// Those that it should have.
        expected: usize,
    },
    /// An agent sees what is no number. Networks may hide it, as the clipping of their inputs does.
    #[error(
        "environment {env}, agent {agent}: observation {index} is {value}, expected a finite number"
    )]
    Observation {
        /// Index of the environment.
        env: usize,
        /// The agent.
        agent: usize,
        /// Which of the numbers that it sees.
        index: usize,
        /// The value.
        value: f32,
    },
    /// An actor gives no number.
    #[error(
        "environment {env}, agent {agent}: the mean of action {action} is {value}; the policy has diverged"
    )]
    Mean {
        /// Index of the environment.
        env: usize,
        /// The agent.
        agent: usize,
        /// Which of its actions.
        action: usize,
        /// The value.
        value: f32,
    },
}

/// The mean actions of `policy`, `[N, A, U]` (before clipping and scaling), for `observations`, `[N, A, O]`, of `n_envs` environments.
///
/// # Errors
/// If arrays are of other sizes, an agent sees what is no number, or an actor gives none.
pub fn act(
    world: &World,
    policy: &Policy,
    (n_envs, observations): (usize, &[f32]),
    executor: &dyn Executor,
    actions: &mut [f32],
) -> Result<(), ActError> {
    let dimensions = &world.dimensions;
    let seen = dimensions.n_agents * dimensions.observation;
    let done = dimensions.n_agents * dimensions.n_actions;
    for (what, found, width) in
        [("observations", observations.len(), seen), ("actions", actions.len(), done)]
    {
        let expected = n_envs * width;
        if found != expected {
            return Err(ActError::Length { what, found, expected });
        }
    }
    if let Some(at) = observations.iter().position(|x| !x.is_finite()) {
        let (env, rest, value) = (at / seen, at % seen, observations[at]);
        let (agent, index) = (rest / dimensions.observation, rest % dimensions.observation);
        return Err(ActError::Observation { env, agent, index, value });
    }
    let parts = observations.chunks(CHUNK * seen).zip(actions.chunks_mut(CHUNK * done));
    executor::for_each(executor, parts.enumerate().collect(), |(index, (observations, actions))| {
        let n_envs = observations.len() / seen;
        let job = Act { dimensions, policy, n_envs, observations, actions: &mut *actions };
        dispatch_for(n_envs, Backend::detect(), job);
        match actions.iter().position(|action| !action.is_finite()) {
            None => Ok(()),
            Some(at) => Err(ActError::Mean {
                env: index * CHUNK + at / done,
                agent: at % done / dimensions.n_actions,
                action: at % dimensions.n_actions,
                value: actions[at],
            }),
        }
    })
}

struct Act<'a> {
    dimensions: &'a Dimensions,
    policy: &'a Policy,
    n_envs: usize,
    observations: &'a [f32],
    actions: &'a mut [f32],
}

impl LaneFn for Act<'_> {
    type Output = ();

    #[inline(always)]
    fn call<S: Real>(self) {
        let Self { dimensions, policy, n_envs, observations, actions } = self;
        let n_groups = n_envs.div_ceil(S::LANES);
        let (input, output) = (dimensions.actor_input(), dimensions.actor_output());
        let (n_agents, o) = (dimensions.n_agents, dimensions.observation);
        let width = n_agents * dimensions.n_actions;
        let mut scratch = Scratch::<S>::new(policy, n_groups);
        let mut seen = vec![S::zero(); n_groups * input];
        let mut means = vec![S::zero(); n_groups * output];
        let mut all = vec![S::zero(); n_groups * width];
        for actor in 0..dimensions.n_actors {
            for group in 0..n_groups {
                for i in 0..input {
                    for lane in 0..S::LANES {
                        // Lanes beyond the last environment repeat it.
                        let env = (group * S::LANES + lane).min(n_envs - 1);
                        let value = observations[env * n_agents * o + actor * input + i];
                        seen[group * input + i].set_lane(lane, f64::from(value));
                    }
                }
            }
            policy.mean(&[actor], &seen, &mut scratch, &mut means);
            for group in 0..n_groups {
                for i in 0..output {
                    let at = group * width + actor * output + i;
                    all[at] = means[group * output + i];
                }
            }
        }
        for group in 0..n_groups {
            let first = group * S::LANES;
            let of_group = &all[group * width..(group + 1) * width];
            write_rows(&mut actions[first * width..], n_envs - first, of_group);
        }
    }
}
