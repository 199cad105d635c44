//! Group `run`: seeds, budgets, processes, and what a resumed run may change.

use serde::{Deserialize, Serialize};

/// Arithmetic of the learner's matrix products.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// `bf16` where the processor multiplies it natively, `f32` elsewhere.
    Auto,
    /// Single precision throughout.
    F32,
    /// Products of bfloat16 with single-precision parameters, sums and moments.
    Bf16,
}

/// Group `run`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// Seed of every random number of the run.
    pub seed: u64,
    /// Budget in env-steps (control steps × environments); schedules run over it.
    pub env_steps: u64,
    /// Wall-clock limit in seconds; only stops, never changes what is learned. 0 means none.
    pub time_limit_s: f64,
    /// Simulator processes at the start; a live run can be scaled. 0 leaves all rollouts to other machines.
    pub workers: usize,
    /// Fixes worker i to the i-th processor that the run may use.
    pub pin: bool,
    /// 1 lets workers roll out the next iteration while the learner trains on this one.
    pub overlap: usize,
    /// `cpu` or `cuda:N`, of the learner.
    pub device: String,
    /// Arithmetic of the learner's products.
    pub precision: Precision,
    /// Threads of the learner; part of the configuration because more threads than networks change sums.
    pub learner_threads: usize,
    /// Commits a checkpoint every so many iterations; 0 means only at the end.
    pub checkpoint_every: u64,
    /// Commits one when the newest is this old (s); 0 turns it off.
    pub checkpoint_every_s: f64,
    /// Newest checkpoints kept. The best, pinned and tagged ones and milestones are kept beside them.
    pub checkpoints_kept: usize,
    /// Bucket that checkpoints are sent to beside the training, as `s3://bucket/prefix`, `gs://…`, `az://…` or
    /// `file:///…`; empty sends none.
    #[serde(default)]
    pub checkpoints: String,
    /// Keeps every checkpoint whose iteration is a multiple of this; 0 turns it off.
    pub keep_every: u64,
    /// Keeps one checkpoint in every such stretch of time, as a milestone (s); 0 turns it off.
    pub milestone_every_s: f64,
    /// Evaluates the policy on held-out goals every so many iterations, on the workers, and commits
    /// a checkpoint when it is the best so far; 0 turns it off.
    pub evaluate_every: u64,
    /// Episodes of such an evaluation.
    pub evaluation_episodes: u32,
    /// Control steps of its episodes.
    pub evaluation_steps: u32,
    /// A policy trained on fewer env-steps is never the best: early luck is no merit.
    pub best_after: u64,
    /// Share of the blocks of other machines that are made a second time on this one and compared; of each machine the
    /// first one always is.
    #[serde(default = "default_audit")]
    pub audit: f64,
    /// A process that is silent this long is replaced and its work is ordered again (s); 1.5 at least,
    /// three signs of life.
    pub order_deadline_s: f64,
}

/// `run.audit` of runs that were begun before there was such a key.
fn default_audit() -> f64 {
    0.01
}

impl Run {
    /// The keys of the group that change nothing that is learned: how many processes work and how
    /// they are watched, when the run stops, and what is measured and kept beside the training.
    ///
    /// Two runs that differ in nothing else end with the same bits, and a run may change them when
    /// it is resumed. All other keys matter, new ones too until they are listed here; `env_steps`
    /// does where the learning rate falls over it.
    pub const HARMLESS: [&str; 15] = [
        "audit",
        "best_after",
        "checkpoint_every",
        "checkpoint_every_s",
        "checkpoints",
        "checkpoints_kept",
        "evaluate_every",
        "evaluation_episodes",
        "evaluation_steps",
        "keep_every",
        "milestone_every_s",
        "order_deadline_s",
        "pin",
        "time_limit_s",
        "workers",
    ];

    /// The keys that matter and may be changed all the same when a run is resumed: another budget
    /// and another device.
    pub const CHANGEABLE: [&str; 2] = ["env_steps", "device"];

    /// Whether a run that was made with `other` may go on with this.
    pub fn continues(&self, other: &Self) -> bool {
        let fixed = |run: &Self| {
            let mut keys = toml::Table::try_from(run).expect("a typed group has a TOML form");
            keys.retain(|key, _| {
                !Self::HARMLESS.contains(&key) && !Self::CHANGEABLE.contains(&key)
            });
            keys
        };
        fixed(self) == fixed(other)
    }

    /// The same without those [harmless](Self::HARMLESS) things that only cost time: checkpoints and
    /// evaluations on the way, a bucket for them, and a time limit.
    #[must_use]
    pub fn without_housekeeping(self) -> Self {
        Self {
            time_limit_s: 0.0,
            checkpoint_every: 0,
            checkpoint_every_s: 0.0,
            checkpoints: String::new(),
            evaluate_every: 0,
            keep_every: 0,
            milestone_every_s: 0.0,
            ..self
        }
    }

    /// Whether the learner sends a snapshot after `iterations` iterations without being asked.
    pub fn plans_snapshot(&self, iterations: u64) -> bool {
        self.plans_checkpoint(iterations) || self.plans_evaluation(iterations)
    }

    /// Whether the state after `iterations` iterations is committed whatever it is worth.
    pub fn plans_checkpoint(&self, iterations: u64) -> bool {
        self.checkpoint_every > 0 && iterations.is_multiple_of(self.checkpoint_every)
    }

    /// Whether the policy after `iterations` iterations is evaluated.
    pub fn plans_evaluation(&self, iterations: u64) -> bool {
        self.evaluate_every > 0 && iterations.is_multiple_of(self.evaluate_every)
    }

    /// Whether a policy that was trained on so many env-steps may be the best: no other is worth an evaluation.
    pub fn may_be_best(&self, env_steps: u64) -> bool {
        self.evaluate_every > 0 && env_steps >= self.best_after
    }

    /// The wall-clock limit, if there is one.
    pub fn time_limit(&self) -> Option<std::time::Duration> {
        (self.time_limit_s > 0.0).then(|| std::time::Duration::from_secs_f64(self.time_limit_s))
    }
}
