//! The trials of a sweep.

use std::path::PathBuf;

use proto::config::TaskName;

use super::halving::{Condition, Next, Standing, next};
use super::record::Record;

/// A sweep.
#[derive(Debug, Clone)]
pub struct Study {
    /// The text of its file.
    pub text: String,
    /// What its configurations are called.
    pub configurations: Vec<String>,
    /// Its trials, in order.
    pub trials: Vec<Trial>,
    /// The best 1 of so many configurations go on from a rung.
    pub reduction: f64,
}

/// A training of it.
#[derive(Debug, Clone)]
pub struct Trial {
    /// What it is called: a file name.
    pub name: String,
    /// Place of its configuration.
    pub configuration: usize,
    /// Seed of its training.
    pub seed: u64,
    /// What it learns.
    pub task: TaskName,
    /// Its run directory, which may be still to be made.
    pub run: PathBuf,
    /// Iterations at which it is scored; the last are its whole budget.
    pub rungs: Vec<u64>,
    /// Env-steps of an iteration.
    pub steps_per_iteration: u64,
}

impl Study {
    /// What each trial does next, by what is recorded of all. `has_failed` says of which it is not tried again.
    pub fn next(&self, records: &[Record], has_failed: impl Fn(usize) -> bool) -> Vec<Next> {
        let standing = |(index, trial): (usize, &Trial)| Standing {
            configuration: trial.configuration,
            scores: trial
                .rungs
                .iter()
                .map(|iteration| records[index].at(*iteration).map(|scored| scored.score))
                .collect(),
            condition: if records[index].damaged {
                Condition::Damaged
            } else if has_failed(index) {
                Condition::Failed
            } else {
                Condition::Fit
            },
        };
        let standings: Vec<Standing> = self.trials.iter().enumerate().map(standing).collect();
        next(&standings, self.reduction)
    }

    /// Env-steps of all trials, if all went to the end; and at most, if no more go on from a rung than may.
    pub fn env_steps(&self) -> [u64; 2] {
        let steps = |trial: &Trial, rung: usize| trial.rungs[rung] * trial.steps_per_iteration;
        let rungs = self.trials.first().map_or(0, |trial| trial.rungs.len());
        let mut all = 0;
        let mut most = 0;
        let mut alive = self.configurations.len();
        for rung in 0..rungs {
            let part = |trial: &Trial| {
                steps(trial, rung) - rung.checked_sub(1).map_or(0, |before| steps(trial, before))
            };
            let mut parts = vec![0; self.configurations.len()];
            for trial in &self.trials {
                parts[trial.configuration] += part(trial);
            }
            all += parts.iter().sum::<u64>();
            parts.sort_unstable_by(|a, b| b.cmp(a));
            most += parts.iter().take(alive).sum::<u64>();
            alive = super::halving::kept(alive, self.reduction);
        }
        [all, most]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_sweep_costs_by_hand() {
        let trial = |configuration: usize, seed: u64| Trial {
            name: String::new(),
            configuration,
            seed,
            task: TaskName::Trajectory,
            run: PathBuf::new(),
            rungs: vec![10, 20, 40],
            steps_per_iteration: 100,
        };
        let study = Study {
            text: String::new(),
            configurations: vec![String::new(); 4],
            trials: (0..8).map(|index| trial(index / 2, index as u64 % 2)).collect(),
            reduction: 2.0,
        };
        // Eight of 40 iterations; eight of 10, four of 10 more, two of 20 more.
        assert_eq!(study.env_steps(), [32_000, 8_000 + 4_000 + 4_000]);
    }
}
