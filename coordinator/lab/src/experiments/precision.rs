//! How near hands and base come to held-out goals.

use std::ffi::OsString;

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::evaluate::Evaluation;
use simulator::experiment::TAIL_STEPS;

use super::common::Common;
use super::lab::{Lab, Needs};
use super::report::{ErrorOfMany, Report, Words};
use super::{Experiment, Name};
use crate::contender::Contender;
use crate::evaluation::Summary;

/// What precision is measured with.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    goals: Words,
    tail_steps: usize,
}

/// The precision of one policy.
#[derive(Debug, Serialize, Deserialize)]
pub struct Precision {
    /// As `octopus eval --json` prints it.
    pub(crate) summary: Summary,
    /// Every hand's errors, or the base's, with their courses.
    pub(crate) errors: Vec<ErrorOfMany>,
}

/// What is asked of the experiment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Study {
    /// Policies, robot, episodes.
    pub common: Common,
    /// Whether the errors of each agent are shown, too.
    pub agents: bool,
}

impl Experiment for Study {
    const NAME: Name = Name::Precision;
    const NEEDS: Needs = Needs::Any;
    type Settings = Settings;
    type Result = Precision;

    fn common(&self) -> &Common {
        &self.common
    }

    fn options(&self) -> Vec<OsString> {
        if self.agents { vec!["--agents".into()] } else { Vec::new() }
    }

    fn settings(&self, lab: &Lab) -> anyhow::Result<Settings> {
        Ok(Settings { goals: lab.whose_goals().to_string().into(), tail_steps: TAIL_STEPS })
    }

    fn work(&self, lab: &Lab) -> u64 {
        let reaching = lab.policies().iter().filter(|policy| policy.task().reaches()).count();
        lab.work(lab.policies().len(), 0) + (reaching * lab.episodes) as u64
    }

    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Precision>> {
        let measure = |policy| {
            let task = Contender::task(policy);
            let recording = lab.play(&trial_of(task), &lab.trial(policy))?;
            let of_hand = |arm| {
                [ErrorOfMany::position(&recording, arm), ErrorOfMany::orientation(&recording, arm)]
            };
            let hands = (0..lab.robot.n_arms).filter(|_| task.reaches()).flat_map(of_hand);
            let base = task.turns().then(|| ErrorOfMany::base(&recording));
            let errors = hands.chain(base).collect();
            let evaluation = Evaluation::of(&recording);
            let reach = lab.reach(policy, &evaluation)?;
            let summary =
                Summary::new(policy.identity(), lab.seed, lab.own_goals(), evaluation, reach);
            Ok(Precision { summary, errors })
        };
        lab.policies().iter().map(measure).collect()
    }

    fn table(columns: usize, report: &Report<Settings, Precision>) -> String {
        tables(columns, report, true)
    }

    fn printed(&self, columns: usize, report: &Report<Settings, Precision>) -> String {
        tables(columns, report, self.agents)
    }
}

/// What a trial is called.
fn trial_of(task: TaskName) -> String {
    format!("precision, {}", task.as_str())
}

impl Precision {
    /// What its trial is called.
    pub(crate) fn trial(&self) -> String {
        trial_of(self.summary.task)
    }
}

/// A table a task, with the errors of each agent if `agents` says so.
fn tables(columns: usize, report: &Report<Settings, Precision>, agents: bool) -> String {
    let tables = report.results.iter().map(|result| {
        format!("{}\n{}", result.summary.task.as_str(), result.summary.table(columns, agents))
    });
    tables.collect::<Vec<_>>().join("\n\n")
}
