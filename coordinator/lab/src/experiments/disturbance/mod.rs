//! What a disturbance does, and how soon it is over.

mod cases;
mod disturbed;
mod recovery;
mod study;
mod table;

use std::ffi::OsString;

use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};

pub use self::cases::Disturbance;
use self::cases::{BASE_STEPS, cases};
pub use self::disturbed::Disturbed;
use self::disturbed::{has_figures, measure};
pub use self::recovery::Recovery;
pub use self::study::Study;
use super::command_line::option;
use super::common::Common;
use super::lab::{Lab, Needs};
use super::report::{Report, Words};
use super::{Experiment, Name};

/// How it is disturbed.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The first disturbed control step.
    at: usize,
    /// The disturbed arm, counted from 1.
    arm: usize,
    force_n: f64,
    torque_n_m: f64,
    errors: Words,
}

impl Study {
    /// Refuses episodes of so many control steps if they end too early.
    pub(crate) fn check_steps(&self, steps: usize) -> Result<(), ExitError> {
        let longest = self.at + 2 * BASE_STEPS;
        if steps > longest {
            return Ok(());
        }
        let message = format!(
            "--steps {steps} ends before the disturbance has, which begins at step {}; it takes {} at least",
            self.at,
            longest + 1
        );
        Err(ExitError::new(ExitCode::Usage, message))
    }
}

impl Experiment for Study {
    const NAME: Name = Name::Disturbance;
    const NEEDS: Needs = Needs::Any;
    type Settings = Settings;
    type Result = Disturbed;

    fn common(&self) -> &Common {
        &self.common
    }

    fn options(&self) -> Vec<OsString> {
        let Self { common: _, arm, at, force, torque } = self;
        vec![
            option("--arm", arm),
            option("--at", at),
            option("--force", force),
            option("--torque", torque),
        ]
    }

    fn settings(&self, lab: &Lab) -> anyhow::Result<Settings> {
        lab.check_arm(self.arm)?;
        self.check_steps(lab.steps)?;
        Ok(Settings {
            at: self.at,
            arm: self.arm,
            force_n: self.force,
            torque_n_m: self.torque,
            errors: "the largest of the three axes".into(),
        })
    }

    fn work(&self, lab: &Lab) -> u64 {
        let cases = Disturbance::ALL.len() * lab.policies().len();
        lab.work(cases, if has_figures(lab) { cases } else { 0 })
    }

    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Disturbed>> {
        let mut results = Vec::new();
        for policy in lab.policies() {
            for case in cases(self, policy.task(), &lab.robot.joints) {
                results.push(measure(lab, policy, self.arm - 1, case)?);
            }
        }
        Ok(results)
    }

    fn table(columns: usize, report: &Report<Settings, Disturbed>) -> String {
        table::table(columns, &report.results, report.protocol.episodes)
    }
}
