//! The metrics of one iteration, flat.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

use proto::message::{Accounting, Errors, IterationReport, Timing};
use proto::{Digest, message};
use serde::Serialize;

use super::live::Live;

/// A line of `metrics.jsonl`; the keys are explained in [the module](super).
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(missing_docs, reason = "every field is a row of the table in the module's essay")]
pub struct Line {
    pub iteration: u64,
    pub env_steps: u64,
    pub digest: Digest,
    pub policy_version: u64,
    pub blocks: Vec<Digest>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub hosts: BTreeMap<String, u64>,
    pub wall_s: f64,
    pub env_steps_per_s: f64,
    pub workers: usize,
    pub restarts: u64,
    pub return_mean: f32,
    pub returns: Vec<f32>,
    pub policy_loss: f32,
    pub value_loss: f32,
    pub entropy: f32,
    pub kl: f32,
    pub clip_fraction: f32,
    pub explained_variance: f32,
    pub actor_grad_norm: f32,
    pub critic_grad_norm: f32,
    pub errors: Errors,
    pub actor_lr: f64,
    pub critic_lr: f64,
    pub action_std: f32,
    pub accounting: Accounting,
    pub timing: Timing,
}

/// A value of a line's table form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell {
    /// A count.
    Count(u64),
    /// A single-precision number, written with as few digits as identify it.
    Single(f32),
    /// A double-precision number, likewise.
    Double(f64),
    /// A digest.
    Digest(Digest),
}

impl Cell {
    /// The value as a number, if it is one.
    pub fn number(self) -> Option<f64> {
        match self {
            Self::Count(value) => Some(value as f64),
            Self::Single(value) => Some(f64::from(value)),
            Self::Double(value) => Some(value),
            Self::Digest(_) => None,
        }
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count(value) => write!(f, "{value}"),
            Self::Single(value) if value.is_finite() => write!(f, "{value}"),
            Self::Double(value) if value.is_finite() => write!(f, "{value}"),
            Self::Single(_) | Self::Double(_) => Ok(()),
            Self::Digest(value) => write!(f, "{value}"),
        }
    }
}

impl Line {
    /// Joins what the learner and the coordinator know.
    pub fn new(report: &IterationReport, live: &Live) -> Self {
        let message::Losses {
            policy,
            value,
            entropy,
            kl,
            clip_fraction,
            explained_variance,
            actor_grad_norm,
            critic_grad_norm,
        } = report.losses;
        let sum: f32 = report.returns.iter().sum();
        Self {
            iteration: report.iteration,
            env_steps: report.env_steps,
            digest: report.digest,
            policy_version: report.policy_version,
            blocks: live.blocks.clone(),
            hosts: live.hosts.clone(),
            wall_s: milliseconds(live.wall_s),
            env_steps_per_s: live.env_steps_per_s.round(),
            workers: live.workers,
            restarts: live.restarts,
            return_mean: sum / report.returns.len().max(1) as f32,
            returns: report.returns.clone(),
            policy_loss: policy,
            value_loss: value,
            entropy,
            kl,
            clip_fraction,
            explained_variance,
            actor_grad_norm,
            critic_grad_norm,
            errors: report.errors,
            actor_lr: report.actor_lr,
            critic_lr: report.critic_lr,
            action_std: report.action_std,
            accounting: report.accounting,
            timing: report.timing,
        }
    }

    /// The line as named cells: the columns of `metrics.csv`, in order.
    pub fn cells(&self) -> Vec<(Cow<'static, str>, Cell)> {
        use Cell::{Count, Double, Single};
        let Errors { position, orientation, base, contact_rate } = self.errors;
        let Accounting { produced, received, trained, duplicate, lost } = self.accounting;
        let Timing { wait_s, update_s, publish_s, digest_s, copy_s, rollout_s } = self.timing;
        let mut cells = vec![
            ("iteration".into(), Count(self.iteration)),
            ("env_steps".into(), Count(self.env_steps)),
            ("digest".into(), Cell::Digest(self.digest)),
            ("policy_version".into(), Count(self.policy_version)),
            ("wall_s".into(), Double(self.wall_s)),
            ("env_steps_per_s".into(), Double(self.env_steps_per_s)),
            ("workers".into(), Count(self.workers as u64)),
            ("restarts".into(), Count(self.restarts)),
            ("return_mean".into(), Single(self.return_mean)),
        ];
        let returns = self.returns.iter().enumerate();
        cells.extend(
            returns.map(|(agent, &value)| (format!("returns.{agent}").into(), Single(value))),
        );
        cells.extend([
            ("policy_loss".into(), Single(self.policy_loss)),
            ("value_loss".into(), Single(self.value_loss)),
            ("entropy".into(), Single(self.entropy)),
            ("kl".into(), Single(self.kl)),
            ("clip_fraction".into(), Single(self.clip_fraction)),
            ("explained_variance".into(), Single(self.explained_variance)),
            ("actor_grad_norm".into(), Single(self.actor_grad_norm)),
            ("critic_grad_norm".into(), Single(self.critic_grad_norm)),
            ("errors.position".into(), Single(position)),
            ("errors.orientation".into(), Single(orientation)),
            ("errors.base".into(), Single(base)),
            ("errors.contact_rate".into(), Single(contact_rate)),
            ("actor_lr".into(), Double(self.actor_lr)),
            ("critic_lr".into(), Double(self.critic_lr)),
            ("action_std".into(), Single(self.action_std)),
            ("accounting.produced".into(), Count(produced)),
            ("accounting.received".into(), Count(received)),
            ("accounting.trained".into(), Count(trained)),
            ("accounting.duplicate".into(), Count(duplicate)),
            ("accounting.lost".into(), Count(lost)),
            ("timing.wait_s".into(), Double(wait_s)),
            ("timing.update_s".into(), Double(update_s)),
            ("timing.publish_s".into(), Double(publish_s)),
            ("timing.digest_s".into(), Double(digest_s)),
            ("timing.copy_s".into(), Double(copy_s)),
            ("timing.rollout_s".into(), Double(rollout_s)),
        ]);
        let blocks = self.blocks.iter().enumerate();
        cells.extend(
            blocks.map(|(shard, &digest)| (format!("blocks.{shard}").into(), Cell::Digest(digest))),
        );
        cells
    }
}

fn milliseconds(seconds: f64) -> f64 {
    (seconds * 1e3).round() / 1e3
}
