//! Snapshots of the training state: when one is asked for, and what becomes of it.
//!
//! The learner sends a snapshot when the plan of the run says so, and when it is asked. It arrives in
//! pieces, and is committed, or its policy is evaluated, or both. One whose policy turns out to be the
//! best so far is committed with its score, whether or not it was to be committed anyway.
//!
//! **Snapshots travel in pieces** of 4 MiB instead of one sample: shared memory stays small, and the size of a
//! training state is no channel constant. **A disk that is slower than the training costs checkpoints, not
//! memory.** While one snapshot is on its way from the learner, others wait there, and while one is written, others
//! wait here, each as far as [`channels::WAITING_SNAPSHOTS`] goes, and the newest best beside them. Planned checkpoints that they displace are reported.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use proto::config::{Config, Run};
use proto::layout::SnapshotHeader;
use proto::message::{EpisodeErrors, EvaluationChunk};
use store::checkpoint::{Assembly, CheckpointStore, Name, Snapshot};
use tokio::sync::oneshot;

use crate::committer::{Committed, Committer};
use crate::report::Evaluated;
use crate::selection::Selection;

/// Who asked for a checkpoint, and is told its name or why there is none.
pub(super) type Asker = oneshot::Sender<Result<String, String>>;

/// What is wanted beside the plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RequestedCheckpoint {
    None,
    /// A checkpoint after at least so many iterations; the learner has not been told.
    Untold(u64),
    /// The same; the learner has been told.
    Told(u64),
}

/// Episodes that the workers play from now on, and those that they need not play any more.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Evaluation {
    pub(super) play: Vec<EvaluationChunk>,
    pub(super) drop: Vec<EvaluationChunk>,
}

/// Where in its life a run is, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Further iterations follow.
    Training,
    /// Everything is trained. The last policy is evaluated unless somebody is waiting for the end.
    Finishing { evaluate: bool },
}

/// See the module.
#[derive(Debug)]
pub(super) struct Snapshots {
    run: Run,
    steps_per_iteration: u64,
    assembly: Assembly,
    selection: Selection,
    committer: Committer,
    store: CheckpointStore,
    wish: RequestedCheckpoint,
    /// What is wanted beyond the wish that the learner has been told: a checkpoint after at least so
    /// many iterations.
    next_wish: Option<u64>,
    askers: Vec<(u64, Asker)>,
    /// Iterations of the newest committed checkpoint, and its directory.
    committed: Option<(u64, PathBuf)>,
    /// Iterations of the newest snapshot that has arrived.
    arrived: u64,
    /// Iterations of planned checkpoints that the learner gave up, because the snapshot before was still on its way.
    given_up: Vec<u64>,
    /// When a snapshot was last handed over for a commit, and its iterations.
    handed_over: (Instant, u64),
}

impl Snapshots {
    /// Of a run with this configuration and robot; `provenance` goes into every manifest. `record` makes
    /// the metrics of a snapshot's iterations durable, see [`Committer::start`].
    pub(super) fn new(
        config: &Config,
        robot_toml: String,
        provenance: serde_json::Value,
        store: CheckpointStore,
        record: impl Fn() -> anyhow::Result<()> + Send + 'static,
    ) -> Self {
        Self {
            run: config.run.clone(),
            steps_per_iteration: config.steps_per_iteration(),
            assembly: Assembly::new(),
            selection: Selection::new(config, best_score(&store)),
            committer: Committer::start(
                store.clone(),
                config.clone(),
                robot_toml,
                provenance,
                record,
            ),
            store,
            wish: RequestedCheckpoint::None,
            next_wish: None,
            askers: Vec::new(),
            committed: None,
            arrived: 0,
            given_up: Vec::new(),
            handed_over: (Instant::now(), 0),
        }
    }

    /// The learner starts from this checkpoint.
    pub(super) fn begin_from(&mut self, checkpoint: Option<(u64, PathBuf)>) {
        self.arrived = checkpoint.as_ref().map_or(0, |(iteration, _)| *iteration);
        self.committed = checkpoint;
    }

    /// The learner is gone, and what it was sending with it. What is handed over already is
    /// committed before this returns.
    pub(super) fn learner_gone(&mut self) {
        self.assembly = Assembly::new();
        self.selection.abandon();
        self.committer.settle();
    }

    /// Training goes on from `iteration`, and whoever still waits for a checkpoint gets a new one.
    pub(super) fn go_on_from(&mut self, iteration: u64) {
        self.wish = if self.askers.is_empty() {
            RequestedCheckpoint::None
        } else {
            RequestedCheckpoint::Untold(iteration)
        };
        self.next_wish = None;
        // Its iterations may come again.
        self.handed_over.1 = 0;
        for (asked, _) in &mut self.askers {
            *asked = iteration.min(*asked);
        }
    }

    /// Wants a checkpoint after at least `iterations`. The learner is told of one wish at a time: what
    /// many want is one snapshot.
    pub(super) fn ask(&mut self, iterations: u64) {
        match self.wish {
            RequestedCheckpoint::None => self.wish = RequestedCheckpoint::Untold(iterations),
            RequestedCheckpoint::Untold(wanted) => {
                self.wish = RequestedCheckpoint::Untold(wanted.max(iterations));
            }
            RequestedCheckpoint::Told(wanted) if iterations > wanted => {
                self.next_wish = self.next_wish.max(Some(iterations));
            }
            RequestedCheckpoint::Told(_) => {}
        }
    }

    /// Wants a checkpoint after at least `iterations`, for somebody.
    pub(super) fn ask_for(&mut self, iterations: u64, asker: Asker) {
        if let Some((newest, _)) = &self.committed
            && *newest == iterations
            && self.wish == RequestedCheckpoint::None
        {
            // Who asked may have gone.
            let _ = asker.send(Ok(Name::of_iteration(*newest).to_string()));
            return;
        }
        // Those who have gone meanwhile are not kept until the next commit, which may be far away.
        self.askers.retain(|(_, asker)| !asker.is_closed());
        self.askers.push((iterations, asker));
        let (_, under_way) = self.handed_over;
        if !(self.committer.is_busy() && under_way >= iterations) {
            self.ask(iterations);
        }
    }

    /// Whether the learner was asked for a snapshot that has not come yet.
    pub(super) fn is_awaited(&self) -> bool {
        matches!(self.wish, RequestedCheckpoint::Told(_))
    }

    /// Lets the committer be, whatever it waits for: the run ends at once.
    pub(super) fn abandon(&mut self) {
        self.committer.abandon();
    }

    /// Whether the learner must be asked for a snapshot now; true once for every wish.
    pub(super) fn must_tell_learner(&mut self) -> bool {
        let RequestedCheckpoint::Untold(iterations) = self.wish else { return false };
        self.wish = RequestedCheckpoint::Told(iterations);
        true
    }

    /// Asks by the clock. While the last commit is being written, none is asked for.
    pub(super) fn iteration_done(&mut self, iterations: u64) {
        let every = self.run.checkpoint_every_s;
        if every > 0.0
            && self.wish == RequestedCheckpoint::None
            && !self.committer.is_busy()
            && self.handed_over.0.elapsed() > Duration::from_secs_f64(every)
        {
            self.ask(iterations);
        }
    }

    /// Takes in a piece; the snapshot if it was the last one.
    pub(super) fn add(&mut self, header: &SnapshotHeader, piece: &[u8]) -> Option<Snapshot> {
        match self.assembly.add(header, piece) {
            Ok(snapshot) => snapshot,
            Err(reason) => {
                tracing::warn!(reason, "a snapshot was cut short");
                None
            }
        }
    }

    /// Whether a snapshot is to be committed whatever its policy is worth.
    pub(super) fn commits(&self, snapshot: &Snapshot) -> bool {
        self.is_requested(snapshot.iteration) || self.run.plans_checkpoint(snapshot.iteration)
    }

    fn is_requested(&self, iteration: u64) -> bool {
        match self.wish {
            RequestedCheckpoint::None => false,
            RequestedCheckpoint::Untold(wanted) | RequestedCheckpoint::Told(wanted) => {
                iteration >= wanted
            }
        }
    }

    /// Commits a snapshot, begins the evaluation of its policy, or both.
    pub(super) fn arrived(&mut self, snapshot: Snapshot, phase: Phase) -> Evaluation {
        let iteration = snapshot.iteration;
        let commits = self.commits(&snapshot);
        if self.is_requested(iteration) {
            let next = self.next_wish.take().filter(|&next| next > iteration);
            self.wish = next.map_or(RequestedCheckpoint::None, RequestedCheckpoint::Untold);
        }
        // They come in order, so what was planned in between does not come any more.
        let between = self.arrived.saturating_add(1)..iteration;
        self.given_up.extend(between.filter(|&passed| self.run.plans_checkpoint(passed)));
        self.arrived = iteration;
        let snapshot = Arc::new(snapshot);
        if commits {
            self.handed_over = (Instant::now(), iteration);
            self.committer.commit(Arc::clone(&snapshot), None);
        }
        let is_due = match phase {
            Phase::Training => self.run.plans_evaluation(iteration),
            Phase::Finishing { evaluate } => evaluate || self.run.plans_evaluation(iteration),
        };
        let env_steps = iteration * self.steps_per_iteration;
        if !is_due || !self.run.may_be_best(env_steps) {
            return Evaluation::default();
        }
        let drop = self.selection.open();
        Evaluation { play: self.selection.begin(snapshot, commits), drop }
    }

    /// Takes in played episodes, and keeps what is the best so far; returns what an evaluation says
    /// that is complete now.
    pub(super) fn played(
        &mut self,
        chunk: EvaluationChunk,
        errors: Vec<EpisodeErrors>,
    ) -> Option<Evaluated> {
        let verdict = self.selection.played(chunk, errors)?;
        let evaluated = Evaluated {
            iteration: verdict.snapshot.iteration,
            env_steps: verdict.snapshot.iteration * self.steps_per_iteration,
            score: verdict.score.value,
            episodes: verdict.score.episodes,
            steps: verdict.score.steps,
            errors: verdict.means,
        };
        if verdict.improved {
            self.committer.commit(verdict.snapshot, Some(verdict.score));
        } else if verdict.committed {
            self.committer.score(verdict.snapshot.iteration, verdict.score);
        }
        Some(evaluated)
    }

    /// What has been written since the last call.
    pub(super) fn results(&mut self) -> Vec<Committed> {
        let given_up = self.given_up.drain(..);
        let mut results: Vec<_> =
            given_up.map(|iteration| Committed::GivenUp { iteration }).collect();
        results.extend(self.committer.results());
        for result in &results {
            match result {
                Committed::Checkpoint { iteration, dir, .. } => {
                    if self.committed.as_ref().is_none_or(|(newest, _)| iteration >= newest) {
                        self.committed = Some((*iteration, dir.clone()));
                    }
                    let name = Name::of_iteration(*iteration).to_string();
                    for (_, asker) in self.askers.extract_if(.., |(asked, _)| iteration >= asked) {
                        let _ = asker.send(Ok(name.clone()));
                    }
                }
                Committed::Failed { error, .. } => {
                    for (_, asker) in self.askers.drain(..) {
                        let _ = asker.send(Err(error.to_string()));
                    }
                    self.selection.set_best(best_score(&self.store));
                }
                Committed::Unrecorded { error, .. } => {
                    for (_, asker) in self.askers.drain(..) {
                        let _ = asker.send(Err(format!("metrics: {error:#}")));
                    }
                }
                Committed::ScoreFailed { .. } => {
                    self.selection.set_best(best_score(&self.store));
                }
                Committed::Score { .. } | Committed::GivenUp { .. } => {}
            }
        }
        results
    }

    /// The directory of the checkpoint after `iterations`, once it is committed and nothing is left
    /// to be evaluated or written.
    pub(super) fn settled_at(&self, iterations: u64) -> Option<&Path> {
        let (newest, dir) = self.committed.as_ref()?;
        let done = *newest == iterations
            && self.wish == RequestedCheckpoint::None
            && self.selection.is_idle()
            && !self.committer.is_busy();
        done.then_some(dir.as_path())
    }

    /// The same without the evaluation, which is given up.
    pub(super) fn settled_unevaluated_at(&mut self, iterations: u64) -> Option<&Path> {
        self.selection.abandon();
        self.settled_at(iterations)
    }
}

fn best_score(store: &CheckpointStore) -> Option<f64> {
    store.best().ok().flatten().and_then(|entry| Some(entry.labels.score.as_ref()?.value))
}

#[cfg(test)]
mod tests;
