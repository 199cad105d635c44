//! Which episodes are played, with what, and where they go.

use proto::config::Config;
use proto::layout::Dimensions;

use super::explore::Noise;
use super::output::Output;
use crate::policy::Policy;
use crate::robot::Robot;
use crate::task::Task;
use crate::task::goal::GoalAddress;

/// A part of a control step that has just ended, for who wants to measure it or to say that it is alive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Forward kinematics, contacts, rewards, observations and writing.
    Observed,
    /// Networks and sampling.
    Decided,
    /// Equations of motion; it ends the control step.
    Moved,
}

/// Environments `first..first + n_envs`, `n_steps` control steps each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Batch {
    pub(crate) first: u32,
    pub(crate) n_envs: usize,
    pub(crate) n_steps: usize,
}

/// Episodes to be played from their start to the end, exploring, as training wants them.
pub(crate) struct Episodes<'a> {
    pub(crate) config: &'a Config,
    pub(crate) robot: &'a Robot,
    pub(crate) task: &'a Task,
    pub(crate) dimensions: &'a Dimensions,
    pub(crate) policy: &'a Policy,
    pub(crate) batch: Batch,
    /// Address of the first environment's goals.
    pub(crate) goals: GoalAddress,
    /// Exploration.
    pub(crate) noise: Noise,
    pub(crate) output: Output<'a>,
    /// Called after every part of a control step; an episode ends with [`Stage::Observed`].
    pub(crate) on_stage: &'a mut dyn FnMut(Stage),
}
