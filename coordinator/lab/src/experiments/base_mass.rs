//! Turning bases of other masses.

use std::ffi::OsString;

use proto::config::TaskName;
use serde::{Deserialize, Serialize};

use super::command_line::list_option;
use super::common::Common;
use super::lab::{Lab, Needs};
use super::report::{ErrorOfMany, Report, Words, share};
use super::{Experiment, Name};
use crate::statistics::milli;

/// How well a base of some mass turns.
#[derive(Debug, Serialize, Deserialize)]
pub struct Weighed {
    /// Of the cube (kg).
    pub(crate) mass: f64,
    /// Of the whole robot (kg).
    total_mass: f64,
    pub(crate) error: ErrorOfMany,
    /// Shares of episodes whose last error is below each threshold, in their order.
    pub(crate) success: Vec<f64>,
}

/// What bases are turned, and what counts.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Attitude errors that count as reached (rad).
    pub(crate) thresholds_rad: Vec<f64>,
    /// Masses of the cube (kg).
    pub(crate) masses_kg: Vec<f64>,
    mass: Words,
}

/// What is asked of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Policies, robot, episodes.
    pub common: Common,
    /// Masses of the cube (kg).
    pub masses: Vec<f64>,
    /// Attitude errors that count as reached (rad).
    pub thresholds: Vec<f64>,
}

impl Default for Study {
    /// As in the paper, and as far as it tells.
    fn default() -> Self {
        Self {
            common: Common::default(),
            masses: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
                .map(|hundreds| 100.0 * hundreds)
                .into(),
            thresholds: vec![0.01, 0.02, 0.03, 0.05, 0.1],
        }
    }
}

/// What a trial is called.
fn trial_of(mass: f64) -> String {
    format!("base mass, {mass} kg")
}

impl Weighed {
    /// What its trial is called.
    pub(crate) fn trial(&self) -> String {
        trial_of(self.mass)
    }
}

impl Experiment for Study {
    const NAME: Name = Name::BaseMass;
    const NEEDS: Needs = Needs::Reorientation;
    /// As in the released protocol.
    const EPISODES: u32 = 50;
    type Settings = Settings;
    type Result = Weighed;

    fn common(&self) -> &Common {
        &self.common
    }

    fn options(&self) -> Vec<OsString> {
        vec![list_option("--masses", &self.masses), list_option("--thresholds", &self.thresholds)]
    }

    fn settings(&self, lab: &Lab) -> anyhow::Result<Settings> {
        for &mass in &self.masses {
            lab.check_fit(&lab.robot.with_base_mass(mass)?, &format!("--masses {mass:?}"))?;
        }
        Ok(Settings {
            thresholds_rad: self.thresholds.clone(),
            masses_kg: self.masses.clone(),
            mass: "of the base's first box; its inertia scales along".into(),
        })
    }

    fn work(&self, lab: &Lab) -> u64 {
        lab.work(self.masses.len(), 0)
    }

    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Weighed>> {
        let measure = |&mass: &f64| {
            let robot = lab.robot.with_base_mass(mass)?;
            let mut trial = lab.trial(lab.policy(TaskName::Reorientation));
            trial.robot = &robot;
            let recording = lab.play(&trial_of(mass), &trial)?;
            let last = recording.steps() - 1;
            let reached = |threshold: &f64| {
                share(recording.episodes(), |e| f64::from(recording.attitude(e, last)) < *threshold)
            };
            Ok(Weighed {
                mass,
                total_mass: robot.total_mass(),
                error: ErrorOfMany::base(&recording),
                success: self.thresholds.iter().map(reached).collect(),
            })
        };
        self.masses.iter().map(measure).collect()
    }

    fn table(columns: usize, report: &Report<Settings, Weighed>) -> String {
        format!(
            "{} each; success is judged after the last step\n{}",
            output::counted(report.protocol.episodes as u64, "episode"),
            table(columns, &report.results, &report.protocol.settings.thresholds_rad)
        )
    }
}

/// An angle (rad) in milliradians, in no more digits than it has.
pub(crate) fn in_mrad(threshold: f64) -> String {
    // A thousandth of a milliradian is below what anybody asks for.
    format!("{}", (1e6 * threshold).round() / 1e3)
}

/// A row a mass and threshold would be long, so thresholds share a column.
fn table(columns: usize, results: &[Weighed], thresholds: &[f64]) -> String {
    let within: Vec<String> = thresholds.iter().map(|t| in_mrad(*t)).collect();
    let success = format!("% within {} mrad", within.join(" / "));
    let rows = results.iter().map(|result| {
        let ErrorOfMany { last, .. } = &result.error;
        let shares: Vec<String> =
            result.success.iter().map(|share| format!("{:.0}", 100.0 * share)).collect();
        let [mean, p50, p90] = [last.mean, last.p50, last.p90].map(milli);
        [format!("{} kg", result.mass), mean, p50, p90, shares.join(" / ")]
    });
    output::table_within(columns, ["base", "final (mrad)", "p50", "p90", &success], rows)
}
