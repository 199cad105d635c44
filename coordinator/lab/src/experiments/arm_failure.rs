//! Turning the base with an arm held or limp.

use std::ffi::OsString;

use proto::config::TaskName;
use serde::{Deserialize, Serialize};
use simulator::experiment::{Effect, FixedGoals, Intervention, Trial};

use super::command_line::option;
use super::common::Common;
use super::lab::{Lab, Needs};
use super::report::{ErrorOfMany, Figure, Goals, Report, share};
use super::{Experiment, Name};
use crate::statistics::{milli, percent};

/// The authors' goal of the figure.
const GOAL: [f64; 3] = [-0.10385, 0.08410, 0.13543];
/// The paper's claim, and the released code's measure of success (rad).
const THRESHOLDS: [f32; 2] = [0.03, 0.05];

/// How an arm fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Failure {
    /// Not at all.
    None,
    /// Its actions are zero: its servos hold it.
    Held,
    /// Its servos give no torque.
    Limp,
}

/// How well the base turns with a failed arm.
#[derive(Debug, Serialize, Deserialize)]
pub struct Failed {
    pub(crate) failure: Failure,
    /// The failed arm, counted from 1.
    arm: Option<usize>,
    pub(crate) error: ErrorOfMany,
    /// Shares of episodes whose last error is below.
    success: Vec<Success>,
    /// An episode with the authors' goal.
    pub(crate) figure: Figure,
}

/// The share of episodes whose last error is below a threshold.
#[derive(Debug, Serialize, Deserialize)]
pub struct Success {
    threshold: f32,
    share: f64,
}

/// Which arms fail, and what counts.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The arms that fail, one at a time, counted from 1.
    arms: Vec<usize>,
    from_step: usize,
    thresholds_rad: [f32; 2],
    figure_goal_rad: [f64; 3],
}

/// Which arm fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failing {
    /// This one, counted from 1.
    One(usize),
    /// Every one in turn.
    Each,
}

/// What is asked of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Policies, robot, episodes.
    pub common: Common,
    /// The arm that fails.
    pub arm: Failing,
}

impl Default for Study {
    /// As in the paper, and as far as it tells.
    fn default() -> Self {
        Self { common: Common::default(), arm: Failing::One(4) }
    }
}

impl Study {
    /// The arms that fail, counted from 0.
    fn arms(&self, lab: &Lab) -> Vec<usize> {
        match self.arm {
            Failing::One(arm) => vec![arm - 1],
            Failing::Each => (0..lab.robot.n_arms).collect(),
        }
    }
}

impl Experiment for Study {
    const NAME: Name = Name::ArmFailure;
    const NEEDS: Needs = Needs::Reorientation;
    type Settings = Settings;
    type Result = Failed;

    fn common(&self) -> &Common {
        &self.common
    }

    fn options(&self) -> Vec<OsString> {
        vec![match self.arm {
            Failing::One(arm) => option("--arm", arm),
            Failing::Each => option("--arm", "all"),
        }]
    }

    fn settings(&self, lab: &Lab) -> anyhow::Result<Settings> {
        if let Failing::One(arm) = self.arm {
            lab.check_arm(arm)?;
        }
        Ok(Settings {
            arms: self.arms(lab).iter().map(|arm| arm + 1).collect(),
            from_step: 0,
            thresholds_rad: THRESHOLDS,
            figure_goal_rad: GOAL,
        })
    }

    fn work(&self, lab: &Lab) -> u64 {
        let cases = 1 + 2 * self.arms(lab).len();
        lab.work(cases, cases)
    }

    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Failed>> {
        let mut results = vec![measure(lab, Failure::None, None)?];
        for arm in self.arms(lab) {
            for failure in [Failure::Held, Failure::Limp] {
                results.push(measure(lab, failure, Some(arm))?);
            }
        }
        Ok(results)
    }

    fn table(columns: usize, report: &Report<Settings, Failed>) -> String {
        let rows = report.results.iter().map(|result| {
            let [paper, released] = [0, 1].map(|index| percent(result.success[index].share));
            let ErrorOfMany { min, last, tail, .. } = &result.error;
            let [min, last] = [min, last].map(|spread| milli(spread.mean));
            let [mean, p50, p90] = [tail.mean, tail.p50, tail.p90].map(milli);
            [result.name(), min, last, mean, p50, p90, paper, released]
        });
        let header =
            ["base (mrad)", "min", "final", "tail", "p50", "p90", "< 30 mrad", "< 50 mrad"];
        format!(
            "{} each; percentiles are those of tail\n{}",
            output::counted(report.protocol.episodes as u64, "episode"),
            output::table_within(columns, header, rows)
        )
    }
}

/// What a trial is called in which an arm, counted from 0, fails.
fn trial_of(failure: Failure, arm: Option<usize>) -> String {
    match arm {
        Some(arm) => format!("arm failure, arm {} {}", arm + 1, failure.word()),
        None => "arm failure, none".to_owned(),
    }
}

impl Failed {
    /// What its trial is called, with these goals.
    pub(crate) fn trial(&self, goals: Goals) -> String {
        goals.of_trial(&trial_of(self.failure, self.arm.map(|arm| arm - 1)))
    }

    /// What it is called.
    pub(crate) fn name(&self) -> String {
        match self.arm {
            Some(arm) => format!("arm {arm} {}", self.failure.word()),
            None => "no failure".to_owned(),
        }
    }
}

impl Failure {
    fn word(self) -> &'static str {
        match self {
            Self::None => "whole",
            Self::Held => "held",
            Self::Limp => "limp",
        }
    }

    /// Has `arm` fail in all of a trial.
    fn happen(self, arm: usize, trial: &mut Trial<'_>) {
        for phase in &mut trial.phases {
            // Whoever would move a limp arm gives no commands either.
            phase.arms[arm] = None;
        }
        if self == Self::Limp {
            let steps = 0..trial.steps;
            trial.interventions.push(Intervention { steps, effect: Effect::Limp { arm } });
        }
    }
}

fn measure(lab: &Lab, failure: Failure, arm: Option<usize>) -> anyhow::Result<Failed> {
    let mut trial = lab.trial(lab.policy(TaskName::Reorientation));
    if let Some(arm) = arm {
        failure.happen(arm, &mut trial);
    }
    let what = trial_of(failure, arm);
    let recording = lab.play(&what, &trial)?;
    trial.episodes = 1;
    trial.fixed = FixedGoals { hands: Vec::new(), base: Some(GOAL) };
    let shown = lab.play(&Goals::Theirs.of_trial(&what), &trial)?;
    let last = recording.steps() - 1;
    let success = THRESHOLDS.map(|threshold| Success {
        threshold,
        share: share(recording.episodes(), |e| recording.attitude(e, last) < threshold),
    });
    Ok(Failed {
        failure,
        arm: arm.map(|arm| arm + 1),
        error: ErrorOfMany::base(&recording),
        success: success.into(),
        figure: Figure::of(&shown, Goals::Theirs, &[]),
    })
}
