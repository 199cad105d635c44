//! What has come of a sweep: numbers of its trials and configurations, and their tables.

use std::path::PathBuf;

use output::grouped;
use proto::config::TaskName;
use proto::run_dir::RunDir;
use proto::statistics::Resamples;
use serde::Serialize;
use store::jsonl;
use store::recorded::Recorded;

use super::halving::Next;
use super::record::Record;
use super::score::{OfReachable, Scored};
use super::study::{Study, Trial};
use crate::statistics::{milli, percent};

/// A number of several trials: its mean within the 95 % bootstrap interval over seeds, `[low, mean, high]`.
pub type Interval = [f64; 3];

/// Where a trial, or all of a configuration, stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Its budget is used up, and it is scored.
    Done,
    /// More is to be done.
    Unfinished,
    /// Others were better at a rung.
    StoppedEarly,
    /// Another seed of its configuration failed, so that this one does not go on.
    AnotherSeedFailed,
    /// It failed when it was last tried.
    Failed,
}

impl State {
    fn of(next: Next) -> Self {
        match next {
            Next::Rung(_) | Next::Wait(_) => Self::Unfinished,
            Next::Stopped(_) => Self::StoppedEarly,
            Next::AnotherFailed(_) => Self::AnotherSeedFailed,
            Next::Failed(_) => Self::Failed,
            Next::Done => Self::Done,
        }
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Unfinished => "unfinished",
            Self::StoppedEarly => "stopped early",
            Self::AnotherSeedFailed => "another seed failed",
            Self::Failed => "failed",
        }
    }
}

/// A trial.
#[derive(Debug, Clone, Serialize)]
pub struct TrialOutcome {
    /// What it is called.
    pub name: String,
    /// What its configuration is called.
    pub configuration: String,
    /// Seed of its training.
    pub seed: u64,
    /// Where it stands.
    pub state: State,
    /// Iterations that are recorded.
    pub iterations: u64,
    /// Iterations of its whole budget.
    pub planned_iterations: u64,
    /// Env-steps that are recorded.
    pub env_steps: u64,
    /// Its last score, with what it was made from.
    pub scored: Option<Scored>,
    /// Time of its training (s).
    pub wall_s: f64,
    /// Processor time of its processes (s), of the sessions whose end was seen.
    pub cpu_s: f64,
    /// Digest of the training state after the last recorded iteration.
    pub digest: Option<String>,
    /// Why it went no further when it was last tried.
    pub failure: Option<String>,
    /// Its run directory.
    pub run_dir: PathBuf,
}

/// All seeds of a configuration together. Errors are those of the newest rung that all of them have come to.
#[derive(Debug, Clone, Serialize)]
pub struct ConfigurationOutcome {
    /// What it is called.
    pub name: String,
    /// What it learns.
    pub task: TaskName,
    /// Its trials.
    pub seeds: usize,
    /// Where they stand.
    pub state: State,
    /// The rung at which it was scored, from 0 on; the last is the end.
    pub rung: Option<usize>,
    /// Iterations after which its first trial was scored there.
    pub iteration: Option<u64>,
    /// Score.
    pub score: Option<Interval>,
    /// Error of the hands' positions (m).
    pub position_m: Option<Interval>,
    /// Error of the hands' orientations, or of the base's attitude (rad).
    pub angle_rad: Option<Interval>,
    /// Share of control steps in contact.
    pub contact_rate: Option<Interval>,
    /// Share of reachable goals missed.
    pub missed: Option<Interval>,
    /// Env-steps of its trials.
    pub env_steps: u64,
    /// Time of its trainings (s).
    pub wall_s: f64,
    /// Processor time of its trainings (s).
    pub cpu_s: f64,
}

/// All of it.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// The best first.
    pub configurations: Vec<ConfigurationOutcome>,
    /// In the order of the file.
    pub trials: Vec<TrialOutcome>,
}

impl Outcome {
    /// What runs and records of `study` say. `has_failed` says which trials count as failed.
    pub fn of(study: &Study, records: &[Record], has_failed: impl Fn(usize) -> bool) -> Self {
        let next = study.next(records, has_failed);
        let trials: Vec<TrialOutcome> = study
            .trials
            .iter()
            .zip(records)
            .zip(&next)
            .map(|((trial, record), next)| TrialOutcome::of(study, trial, record, *next))
            .collect();
        let mut configurations: Vec<ConfigurationOutcome> = (0..study.configurations.len())
            .map(|index| ConfigurationOutcome::of(study, index, records, &trials))
            .collect();
        // Who came further, and of these who is better; what has no score comes last.
        let key = |of: &ConfigurationOutcome| {
            let score = of.score.map_or(f64::INFINITY, |[_, mean, _]| mean);
            // Not by iterations: how many a budget is depends on the configuration.
            (std::cmp::Reverse(of.rung), score)
        };
        configurations.sort_by(|a, b| {
            let (a, b) = (key(a), key(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        });
        Self { configurations, trials }
    }

    /// Trials that have failed.
    pub fn failed(&self) -> Vec<&TrialOutcome> {
        self.trials.iter().filter(|trial| trial.state == State::Failed).collect()
    }

    /// What the cells of a [row](ConfigurationOutcome::row) are.
    pub const HEADER: [&'static str; 9] = [
        "configuration",
        "seeds",
        "state",
        "score",
        "position (mm)",
        "angle (mrad)",
        "missed",
        "contact",
        "training (min)",
    ];

    /// The configurations as a person reads them.
    pub fn table(&self, columns: usize) -> String {
        let rows = self.configurations.iter().map(ConfigurationOutcome::row);
        output::table_within(columns, Self::HEADER, rows)
    }

    /// What the cells of a [trial's row](TrialOutcome::row) are.
    pub const TRIALS: [&'static str; 8] = [
        "trial",
        "state",
        "iterations",
        "score",
        "position (mm)",
        "angle (mrad)",
        "training (min)",
        "processors (min)",
    ];

    /// The trials as comma-separated values, in SI units.
    pub fn csv(&self) -> anyhow::Result<Vec<u8>> {
        let mut table = csv::Writer::from_writer(Vec::new());
        table.write_record([
            "trial",
            "configuration",
            "seed",
            "state",
            "iterations",
            "planned_iterations",
            "env_steps",
            "wall_s",
            "cpu_s",
            "scored_iteration",
            "score",
            "episodes",
            "position_m",
            "angle_rad",
            "contact_rate",
            "reachable_goals",
            "reachable_position_m",
            "reachable_orientation_rad",
            "reachable_missed",
            "digest",
            "failure",
        ])?;
        for trial in &self.trials {
            table.write_record(trial.cells())?;
        }
        Ok(table.into_inner()?)
    }
}

impl TrialOutcome {
    fn of(study: &Study, trial: &Trial, record: &Record, next: Next) -> Self {
        let run_dir = RunDir::new(&trial.run);
        // One damaged file does not hide what the others say.
        let (recorded, wall_s, damage) = match read(&run_dir) {
            Ok((recorded, wall_s)) => (recorded, wall_s, None),
            Err(error) => (Recorded::default(), 0.0, Some(run::errors::told(&error))),
        };
        let iterations = recorded.iterations();
        let scored = trial.rungs.iter().rev().find_map(|rung| record.at(*rung));
        Self {
            name: trial.name.clone(),
            configuration: study.configurations[trial.configuration].clone(),
            seed: trial.seed,
            state: if damage.is_some() { State::Failed } else { State::of(next) },
            iterations,
            planned_iterations: trial.rungs.last().copied().unwrap_or(0),
            env_steps: iterations * trial.steps_per_iteration,
            scored: scored.cloned(),
            wall_s,
            cpu_s: record.cpu_s,
            digest: recorded.digest_after(iterations).map(|digest| digest.to_string()),
            failure: damage.or_else(|| record.failure.clone()),
            run_dir: trial.run.clone(),
        }
    }

    /// As a row of a table.
    pub fn row(&self) -> [String; 8] {
        let scored = self.scored.as_ref();
        let of = |read: fn(&Scored) -> String| scored.map_or_else(String::new, read);
        [
            self.name.clone(),
            self.state.words().to_owned(),
            format!("{} of {}", grouped(self.iterations), grouped(self.planned_iterations)),
            of(|scored| format!("{:.3}", scored.score)),
            of(|scored| scored.position_m.map_or_else(String::new, milli)),
            of(|scored| milli(scored.angle_rad)),
            minutes(self.wall_s),
            minutes(self.cpu_s),
        ]
    }

    fn cells(&self) -> Vec<String> {
        let scored = self.scored.as_ref();
        let of = |read: fn(&Scored) -> Option<f64>| {
            let value = scored.and_then(read).filter(|value| value.is_finite());
            value.map_or_else(String::new, |value| value.to_string())
        };
        let reachable = |read: fn(&OfReachable) -> f64| {
            let value = scored.and_then(|scored| scored.reachable.as_ref()).map(read);
            let value = value.filter(|value| value.is_finite());
            value.map_or_else(String::new, |value| value.to_string())
        };
        let text = |text: &Option<String>| text.clone().unwrap_or_default();
        vec![
            self.name.clone(),
            self.configuration.clone(),
            self.seed.to_string(),
            self.state.words().to_owned(),
            self.iterations.to_string(),
            self.planned_iterations.to_string(),
            self.env_steps.to_string(),
            self.wall_s.to_string(),
            self.cpu_s.to_string(),
            scored.map_or_else(String::new, |scored| scored.iteration.to_string()),
            of(|scored| Some(scored.score)),
            scored.map_or_else(String::new, |scored| scored.episodes.to_string()),
            of(|scored| scored.position_m),
            of(|scored| Some(scored.angle_rad)),
            of(|scored| Some(scored.contact_rate)),
            scored
                .and_then(|scored| scored.reachable.as_ref())
                .map_or_else(String::new, |of| of.goals.to_string()),
            reachable(|of| of.position_m),
            reachable(|of| of.orientation_rad),
            reachable(|of| of.missed),
            text(&self.digest),
            text(&self.failure),
        ]
    }
}

impl ConfigurationOutcome {
    fn of(study: &Study, index: usize, records: &[Record], outcomes: &[TrialOutcome]) -> Self {
        let own: Vec<usize> = (0..study.trials.len())
            .filter(|trial| study.trials[*trial].configuration == index)
            .collect();
        let first = &study.trials[own[0]];
        let scored_at = |rung: usize| -> Option<Vec<&Scored>> {
            own.iter().map(|at| records[*at].at(study.trials[*at].rungs[rung])).collect()
        };
        let scored_there = |rung| Some((rung, scored_at(rung)?));
        let (rung, scored) = (0..first.rungs.len()).rev().find_map(scored_there).unzip();
        let over_seeds = |read: fn(&Scored) -> Option<f64>| -> Option<Interval> {
            let values: Option<Vec<f64>> =
                scored.as_ref()?.iter().map(|scored| read(scored)).collect();
            let values = values?;
            Some(Resamples::of(values.len()).interval(&values))
        };
        let states = || own.iter().map(|at| outcomes[*at].state);
        let state =
            [State::Failed, State::AnotherSeedFailed, State::Unfinished, State::StoppedEarly]
                .into_iter()
                .find(|state| states().any(|of| of == *state))
                .unwrap_or(State::Done);
        let sum = |read: fn(&TrialOutcome) -> f64| own.iter().map(|at| read(&outcomes[*at])).sum();
        Self {
            name: study.configurations[index].clone(),
            task: first.task,
            seeds: own.len(),
            state,
            rung,
            iteration: scored.as_ref().map(|scored| scored[0].iteration),
            score: over_seeds(|scored| Some(scored.score)),
            position_m: over_seeds(|scored| scored.position_m),
            angle_rad: over_seeds(|scored| Some(scored.angle_rad)),
            contact_rate: over_seeds(|scored| Some(scored.contact_rate)),
            missed: over_seeds(|scored| Some(scored.reachable.as_ref()?.missed)),
            env_steps: own.iter().map(|at| outcomes[*at].env_steps).sum(),
            wall_s: sum(|trial| trial.wall_s),
            cpu_s: sum(|trial| trial.cpu_s),
        }
    }

    /// As a row of a table.
    pub fn row(&self) -> [String; 9] {
        let shown = |of: Option<Interval>, show: fn(f64) -> String| match of {
            None => String::new(),
            Some([_, mean, _]) if self.seeds == 1 => show(mean),
            Some([low, mean, high]) => format!("{} ({} to {})", show(mean), show(low), show(high)),
        };
        let mean = |of: Option<Interval>| of.map_or_else(String::new, |[_, mean, _]| percent(mean));
        [
            self.name.clone(),
            self.seeds.to_string(),
            self.state.words().to_owned(),
            shown(self.score, |score| format!("{score:.3}")),
            shown(self.position_m, milli),
            shown(self.angle_rad, milli),
            mean(self.missed),
            mean(self.contact_rate),
            minutes(self.wall_s),
        ]
    }
}

/// A time as a table shows it.
pub(super) fn minutes(seconds: f64) -> String {
    format!("{:.1}", seconds / 60.0)
}

/// What a run has recorded, and the time of all its sessions (s), by its last recorded iteration.
fn read(run_dir: &RunDir) -> anyhow::Result<(Recorded, f64)> {
    let metrics = run_dir.metrics_jsonl();
    let lines = jsonl::read(&metrics)?;
    let wall_s = lines.last().and_then(|(_, line)| line["wall_s"].as_f64());
    Ok((Recorded::of_lines(metrics, &lines)?, wall_s.unwrap_or(0.0)))
}

#[cfg(test)]
mod tests {
    use proto::Digest;

    use super::*;

    /// A trial of each configuration, with these rungs and the scores that it has at them.
    fn outcome(trials: &[(&[u64], &[f64])], reduction: f64) -> Outcome {
        let study = Study {
            text: String::new(),
            configurations: (0..trials.len()).map(|index| index.to_string()).collect(),
            trials: trials
                .iter()
                .enumerate()
                .map(|(configuration, (rungs, _))| Trial {
                    name: String::new(),
                    configuration,
                    seed: 1,
                    task: TaskName::Trajectory,
                    run: PathBuf::from("no/such/run"),
                    rungs: rungs.to_vec(),
                    steps_per_iteration: 1,
                })
                .collect(),
            reduction,
        };
        let scored = |(iteration, score): (&u64, &f64)| Scored {
            iteration: *iteration,
            digest: Digest::default(),
            score: *score,
            episodes: 1,
            position_m: None,
            angle_rad: 0.0,
            contact_rate: 0.0,
            reachable: None,
        };
        let records: Vec<Record> = trials
            .iter()
            .map(|(rungs, scores)| Record {
                scores: rungs.iter().zip(*scores).map(scored).collect(),
                ..Record::default()
            })
            .collect();
        Outcome::of(&study, &records, |_| false)
    }

    fn order(outcome: &Outcome) -> Vec<&str> {
        outcome.configurations.iter().map(|of| of.name.as_str()).collect()
    }

    /// With twice the environments a budget is half as many iterations.
    #[test]
    fn the_best_comes_first_however_many_iterations_its_budget_is() {
        let all = outcome(&[(&[20], &[2.0]), (&[10], &[1.0]), (&[40], &[3.0])], 1.0);
        assert_eq!(order(&all), ["1", "0", "2"]);
        // Who came further is before who was better at a rung, and who has no score is last.
        let halved = outcome(
            &[(&[40, 80], &[]), (&[20, 40], &[0.5]), (&[5, 10], &[1.0, 9.0]), (&[5, 10], &[3.0])],
            2.0,
        );
        assert_eq!(order(&halved), ["2", "1", "3", "0"]);
        assert_eq!(halved.configurations[0].rung, Some(1));
    }

    #[test]
    fn a_damaged_run_hides_no_other() {
        let dir = tempfile::tempdir().expect("tempdir");
        let trial = |seed: u64| Trial {
            name: seed.to_string(),
            configuration: 0,
            seed,
            task: TaskName::Trajectory,
            run: dir.path().join(seed.to_string()),
            rungs: vec![1],
            steps_per_iteration: 10,
        };
        let study = Study {
            text: String::new(),
            configurations: vec![String::new()],
            trials: [0, 1].map(trial).to_vec(),
            reduction: 1.0,
        };
        let digest = Digest::default();
        let line = format!("{{\"iteration\":0,\"digest\":\"{digest}\",\"wall_s\":2.0}}\n");
        for (trial, text) in study.trials.iter().zip([line.as_str(), "{\"iteration\":7}\n"]) {
            std::fs::create_dir(&trial.run).expect("made");
            std::fs::write(RunDir::new(&trial.run).metrics_jsonl(), text).expect("written");
        }
        let outcome = Outcome::of(&study, &[Record::default(), Record::default()], |_| false);
        let [whole, damaged] = [&outcome.trials[0], &outcome.trials[1]];
        assert_eq!((whole.iterations, whole.wall_s, &whole.failure), (1, 2.0, &None));
        assert_eq!((damaged.state, damaged.iterations), (State::Failed, 0));
        let failure = damaged.failure.as_deref().unwrap_or_default();
        assert!(failure.contains("metrics.jsonl: line 1: is of iteration 7"), "{failure}");
        assert_eq!(outcome.configurations[0].state, State::Failed);
    }
}
