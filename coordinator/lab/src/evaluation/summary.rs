//! What an evaluation found, in the form that is stored.

use std::path::PathBuf;

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::evaluate::{ContactSteps, EpisodeResult, Evaluation};

use super::errors::{ErrorSummary, agents, overall};
use super::held::HeldShare;
use super::reach::{Reach, Reachable, WithinReach};
use super::success::{Success, success};
use crate::goals::OwnGoals;
use crate::identity::{ControllerName, Identity};

/// Shares of control steps at whose end bodies touched, by what touched what.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ContactRates {
    /// An arm and a box of the base.
    pub arm_base: f64,
    /// An arm and a mount or pedestal.
    pub arm_mount: f64,
    /// An arm and itself.
    pub arm_itself: f64,
    /// Two arms.
    pub arm_arm: f64,
}

/// What an evaluation found; the form of `eval --json` and `evaluation.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The controller that was evaluated, if it was no policy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller: Option<ControllerName>,
    /// What was evaluated.
    pub checkpoint: PathBuf,
    /// Iterations it was trained on.
    pub iteration: u64,
    /// Env-steps it was trained on.
    pub env_steps: u64,
    /// Its task.
    pub task: TaskName,
    /// Seed of the goals.
    pub seed: u64,
    /// The file of the goals, where they were not drawn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goals: Option<PathBuf>,
    /// Control steps of an episode.
    pub steps: usize,
    /// All agents together.
    pub overall: Vec<ErrorSummary>,
    /// Every agent alone; empty in `reorientation`, where all answer for the base.
    pub agents: Vec<ErrorSummary>,
    /// By threshold: the released code's and the paper's.
    pub success: Vec<Success>,
    /// How often goals were held, in tasks in which they have to be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held: Option<HeldShare>,
    /// The same for goals that can be reached; in `trajectory`, if it was asked for.
    pub reachable: Option<Reachable>,
    /// The same for goals that were within reach at the end; likewise.
    pub within_reach_at_end: Option<WithinReach>,
    /// Share of control steps at whose end any two bodies touched.
    pub contact_rate: f64,
    /// The same by what touched what.
    pub contact_rate_by_kind: ContactRates,
    /// Episodes with any contact.
    pub episodes_with_contact: usize,
    /// Every episode.
    pub episodes: Vec<EpisodeResult>,
}

impl Summary {
    /// What `evaluation` of a policy on the goals of `seed`, or on a person's own, says; `reach` as from [`Reach::of`].
    pub fn new(
        identity: &Identity,
        seed: u64,
        own: Option<&OwnGoals>,
        evaluation: Evaluation,
        reach: Option<Reach>,
    ) -> Self {
        let task = identity.task;
        let Evaluation { steps, episodes } = evaluation;
        let share = |contact_steps: fn(&EpisodeResult) -> u32| {
            let sum: f64 = episodes.iter().map(|episode| f64::from(contact_steps(episode))).sum();
            sum / (episodes.len() * steps).max(1) as f64
        };
        let of_kind = |kind: fn(&ContactSteps) -> u32| {
            let each =
                episodes.iter().map(|episode| f64::from(kind(&episode.contact_steps_by_kind)));
            each.sum::<f64>() / (episodes.len() * steps).max(1) as f64
        };
        let (reachable, within_reach_at_end) = reach.map(|reach| reach.subsets(&episodes)).unzip();
        Self {
            controller: identity.controller,
            checkpoint: identity.checkpoint.clone(),
            iteration: identity.iteration,
            env_steps: identity.env_steps,
            task,
            seed,
            goals: own.map(|own| own.file.clone()),
            steps,
            overall: overall(task, &episodes),
            agents: agents(task, &episodes),
            success: success(task, &episodes),
            held: HeldShare::of(&episodes),
            reachable,
            within_reach_at_end,
            contact_rate: share(|episode| episode.contact_steps),
            contact_rate_by_kind: ContactRates {
                arm_base: of_kind(|kinds| kinds.arm_base),
                arm_mount: of_kind(|kinds| kinds.arm_mount),
                arm_itself: of_kind(|kinds| kinds.arm_itself),
                arm_arm: of_kind(|kinds| kinds.arm_arm),
            },
            episodes_with_contact: episodes
                .iter()
                .filter(|episode| episode.contact_steps > 0)
                .count(),
            episodes,
        }
    }
}
