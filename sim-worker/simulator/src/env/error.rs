//! What can go wrong in an episode.

use super::Moment;
use crate::scalar::Real;
use crate::state::State;
use crate::task::Goals;

/// A number that is none, or a state beyond all bounds, caught in the step that made it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EpisodeError {
    /// The policy gives no number.
    #[error(
        "environment {env}, step {step}, agent {agent}: the mean of action {action} is {value}; \
         the policy has diverged"
    )]
    Action {
        /// Global index of the environment.
        env: u32,
        /// Control step.
        step: usize,
        /// The agent.
        agent: usize,
        /// Which of its three actions.
        action: usize,
        /// The value.
        value: f64,
        /// The environment before the step.
        moment: Option<Box<Moment>>,
    },
    /// The simulation has diverged.
    #[error(
        "environment {env}, step {step}{agent}: {quantity} is {value}, not within ±{limit}; the \
         simulation has diverged: a smaller env.substep helps, or smaller forces",
        agent = agent.map_or_else(String::new, |agent| format!(", agent {agent}"))
    )]
    State {
        /// Global index of the environment.
        env: u32,
        /// Control step during which it happened.
        step: usize,
        /// The agent whose joint it is, if it is a joint.
        agent: Option<usize>,
        /// What it is.
        quantity: &'static str,
        /// The value.
        value: f64,
        /// The largest value that makes sense.
        limit: f64,
        /// The environment before the step.
        moment: Option<Box<Moment>>,
    },
}

impl EpisodeError {
    /// Global index of the environment.
    pub fn env(&self) -> u32 {
        match self {
            Self::Action { env, .. } | Self::State { env, .. } => *env,
        }
    }

    /// Control step.
    pub fn step(&self) -> usize {
        match self {
            Self::Action { step, .. } | Self::State { step, .. } => *step,
        }
    }

    /// The environment before the step, if it was kept.
    pub fn moment(&self) -> Option<&Moment> {
        match self {
            Self::Action { moment, .. } | Self::State { moment, .. } => moment.as_deref(),
        }
    }

    /// Keeps the environment; `first` is the global index of the group's first lane.
    #[cold]
    pub(crate) fn keep<S: Real>(
        mut self,
        first: u32,
        state: &State<S>,
        goals: &Goals<S>,
        command: &[S],
    ) -> Self {
        let lane = (self.env() - first) as usize;
        match &mut self {
            Self::Action { moment, .. } | Self::State { moment, .. } => {
                *moment = Some(Box::new(Moment::of_lane(lane, state, goals, command)));
            }
        }
        self
    }
}
