//! Which checkpoint is the best: held-out episodes, played by the workers as ordinary orders.
//!
//! The learner sends a snapshot with every policy that is to be evaluated. The snapshot waits here
//! until its episodes have been played, and is committed if they are better than all before it. The
//! goals are always the same ([`SELECTION_SEED`]), the actions the policy's means, so the score of a
//! policy is a pure function of its parameters; nothing of it flows back into the training.
//!
//! The goals are of their own ([`SELECTION_SEED`]), so that `octopus eval` measures on goals that neither the
//! training nor the choice has seen.

use std::collections::BTreeMap;
use std::sync::Arc;

use proto::config::{Config, TaskName};
use proto::message::{EpisodeErrors, EvaluationChunk, TaskErrors};
use serde::Serialize;
use simulator::evaluate::SELECTION_SEED;
use simulator::scalar::LANES;
use store::checkpoint::{Score, Snapshot};

/// Errors that the paper reports for its best policies: position (m), orientation (rad), and
/// attitude of the base (rad). Scores are in these units, so that 1 is as good as the paper.
pub const PAPER: TaskErrors = TaskErrors { position: 0.025, orientation: 0.04, base: 0.03 };

/// Errors of a policy, means over the episodes of its evaluation. Positions in m, attitudes in rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Means {
    /// Over the last steps.
    pub tail: MeanErrors,
    /// Minima over time: the paper's measure.
    pub min: MeanErrors,
}

/// [`TaskErrors`], summed up with more digits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeanErrors {
    /// Position error of hands (m).
    pub position: f64,
    /// Orientation error of hands (rad).
    pub orientation: f64,
    /// Attitude error of the base (rad).
    pub base: f64,
}

impl MeanErrors {
    /// Position (m), orientation (rad), and attitude of the base (rad).
    pub fn numbers(&self) -> [f64; 3] {
        [self.position, self.orientation, self.base]
    }

    /// The largest of the errors that `task` is about, in units of the paper's: at most 1 is as good as the paper.
    pub fn in_papers(&self, task: TaskName) -> f64 {
        self.shares(task).reduce(f64::max).unwrap_or(f64::NAN)
    }

    /// The score of a policy with these errors: the mean of those that `task` is about, in units of the paper's, so that 1 is as
    /// good as the paper, and the smaller, the better.
    pub fn score(&self, task: TaskName) -> f64 {
        let n = self.shares(task).count() as f64;
        self.shares(task).sum::<f64>() / n
    }

    /// The errors that `task` is about, in units of the paper's.
    fn shares(&self, task: TaskName) -> impl Iterator<Item = f64> {
        let of = |error: f64, paper: f32| error / f64::from(paper);
        let hands = [of(self.position, PAPER.position), of(self.orientation, PAPER.orientation)];
        let hands = hands.into_iter().filter(move |_| task.reaches());
        hands.chain(task.turns().then_some(of(self.base, PAPER.base)))
    }

    /// One kind of the errors of some episodes.
    fn of(episodes: &[EpisodeErrors], kind: fn(&EpisodeErrors) -> &TaskErrors) -> Self {
        let mean = |error: fn(&TaskErrors) -> f32| {
            let errors = episodes.iter().map(|episode| f64::from(error(kind(episode))));
            errors.sum::<f64>() / episodes.len() as f64
        };
        Self {
            position: mean(|errors| errors.position),
            orientation: mean(|errors| errors.orientation),
            base: mean(|errors| errors.base),
        }
    }
}

/// What became of an evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The training state that the policy belongs to.
    pub snapshot: Arc<Snapshot>,
    /// Whether that has been handed over for a commit already.
    pub committed: bool,
    /// How good the policy is.
    pub score: Score,
    /// What it was made from.
    pub means: Means,
    /// Whether it is better than all before it.
    pub improved: bool,
}

/// The evaluation under way, and the best score so far.
#[derive(Debug)]
pub struct Selection {
    task: TaskName,
    episodes: u32,
    steps: u32,
    best: Option<f64>,
    current: Option<Current>,
}

#[derive(Debug)]
struct Current {
    snapshot: Arc<Snapshot>,
    committed: bool,
    open: Vec<EvaluationChunk>,
    /// By first episode, so that the order of arrival does not matter.
    errors: BTreeMap<u32, Vec<EpisodeErrors>>,
}

impl Selection {
    /// Nothing evaluated; `best` is the best score of the run's earlier sessions.
    pub fn new(config: &Config, best: Option<f64>) -> Self {
        let run = &config.run;
        Self {
            task: config.task.name,
            episodes: run.evaluation_episodes,
            steps: run.evaluation_steps,
            best,
            current: None,
        }
    }

    /// Begins the evaluation of a snapshot's policy; returns the episodes to be ordered. One that is
    /// still under way is given up, see [`Self::open`]. `committed` says whether the snapshot is
    /// committed anyway.
    pub fn begin(&mut self, snapshot: Arc<Snapshot>, committed: bool) -> Vec<EvaluationChunk> {
        let iteration = snapshot.iteration;
        let open: Vec<_> = (0..self.episodes)
            .step_by(LANES)
            .map(|first| EvaluationChunk {
                policy_version: iteration,
                first,
                episodes: (self.episodes - first).min(LANES as u32),
            })
            .collect();
        let errors = BTreeMap::new();
        self.current = Some(Current { snapshot, committed, open: open.clone(), errors });
        open
    }

    /// Episodes that are not played yet.
    pub fn open(&self) -> Vec<EvaluationChunk> {
        self.current.as_ref().map_or_else(Vec::new, |current| current.open.clone())
    }

    /// Whether nothing is being evaluated.
    pub fn is_idle(&self) -> bool {
        self.current.is_none()
    }

    /// Gives up what is being evaluated.
    pub fn abandon(&mut self) {
        self.current = None;
    }

    /// Takes in played episodes. Without errors the policy could not be played: given up.
    pub fn played(
        &mut self,
        chunk: EvaluationChunk,
        errors: Vec<EpisodeErrors>,
    ) -> Option<Verdict> {
        let current = self.current.as_mut()?;
        let place = current.open.iter().position(|open| *open == chunk)?;
        if errors.len() != chunk.episodes as usize {
            self.current = None;
            return None;
        }
        current.open.swap_remove(place);
        current.errors.insert(chunk.first, errors);
        if !current.open.is_empty() {
            return None;
        }
        let Current { snapshot, committed, errors, .. } = self.current.take()?;
        let episodes: Vec<_> = errors.into_values().flatten().collect();
        let means = Means {
            tail: MeanErrors::of(&episodes, |errors| &errors.tail),
            min: MeanErrors::of(&episodes, |errors| &errors.min),
        };
        let score = self.score(&means.tail, episodes.len());
        let improved = self.best.is_none_or(|best| score.value < best);
        if improved {
            self.best = Some(score.value);
        }
        Some(Verdict { snapshot, committed, score, means, improved })
    }

    /// The best could not be kept: this is the score of the best that there is.
    pub fn set_best(&mut self, best: Option<f64>) {
        self.best = best;
    }

    fn score(&self, tail: &MeanErrors, episodes: usize) -> Score {
        let MeanErrors { position, orientation, base } = *tail;
        let hands = [("position_m", position), ("orientation_rad", orientation)];
        let hands = hands.into_iter().filter(|_| self.task.reaches());
        let errors = hands.chain(self.task.turns().then_some(("base_rad", base)));
        Score {
            value: tail.score(self.task),
            errors: errors.map(|(name, error)| (name.to_owned(), error)).collect(),
            episodes: episodes as u64,
            steps: u64::from(self.steps),
            seed: SELECTION_SEED,
        }
    }
}

#[cfg(test)]
mod tests {
    use proto::Digest;
    use proto::config::{Layers, Preset};

    use super::*;

    fn selection(best: Option<f64>) -> Selection {
        let layers = Layers::new(Preset::Tuned, None).set("run.evaluation_episodes=18");
        let config = layers.and_then(|layers| layers.resolve()).expect("valid");
        Selection::new(&config, best)
    }

    fn snapshot(iteration: u64) -> Arc<Snapshot> {
        Arc::new(Snapshot { iteration, digest: Digest([0; 16]), bytes: Vec::new() })
    }

    fn errors(count: u32, position: f32) -> Vec<EpisodeErrors> {
        let tail = TaskErrors { position, orientation: 0.02, base: 9.0 };
        let min = TaskErrors { position: 0.5 * position, ..tail };
        vec![EpisodeErrors { tail, min }; count as usize]
    }

    #[test]
    fn a_score_does_not_depend_on_the_order_of_arrival() {
        let mut verdicts = Vec::new();
        for order in [[0, 1], [1, 0]] {
            let mut selection = selection(None);
            let chunks = selection.begin(snapshot(10), false);
            assert_eq!(chunks.iter().map(|chunk| chunk.episodes).collect::<Vec<_>>(), [16, 2]);
            let [first, last] = order.map(|place| chunks[place]);
            let play =
                |chunk: EvaluationChunk| errors(chunk.episodes, 0.01 + 1e-4 * chunk.first as f32);
            assert_eq!(selection.played(first, play(first)), None);
            // A repeated answer changes nothing.
            assert_eq!(selection.played(first, play(first)), None);
            verdicts.push(selection.played(last, play(last)).expect("complete"));
            assert!(selection.is_idle());
        }
        assert_eq!(verdicts[0], verdicts[1]);
        // (16 · 10 mm + 2 · 11.6 mm) / 18 of 25 mm, 20 mrad of 40 mrad.
        let expected = 0.5 * ((16.0 * 0.01 + 2.0 * 0.0116) / 18.0 / 0.025 + 0.5);
        assert!((verdicts[0].score.value - expected).abs() < 1e-6, "{:?}", verdicts[0]);
        assert!(verdicts[0].improved);
        let Means { tail, min } = verdicts[0].means;
        assert!((tail.position - 2.0 * min.position).abs() < 1e-9, "{tail:?} {min:?}");
        assert!((min.base - 9.0).abs() < 1e-9);
    }

    #[test]
    fn only_a_better_one_improves_and_a_policy_that_is_gone_is_given_up() {
        let mut selection = selection(Some(0.5));
        for (position, improved) in [(0.03, false), (0.001, true), (0.001, false)] {
            let chunks = selection.begin(snapshot(1), false);
            let verdict = chunks
                .into_iter()
                .find_map(|chunk| selection.played(chunk, errors(chunk.episodes, position)))
                .expect("complete");
            assert_eq!(verdict.improved, improved, "{position}");
        }
        let chunks = selection.begin(snapshot(2), false);
        assert_eq!(selection.played(chunks[0], Vec::new()), None);
        assert!(selection.is_idle());
    }
}
