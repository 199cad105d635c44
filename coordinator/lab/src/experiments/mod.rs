//! The paper's experiments, one file each.
//!
//! A `Study` is what is asked of an [`Experiment`]. [`perform`] makes a [`Report`] of it, which is what `octopus experiment` prints
//! and what `octopus reproduce` writes and draws.

pub mod arm_failure;
pub mod base_mass;
pub mod command_line;
pub mod common;
pub mod disturbance;
pub mod lab;
pub mod noise;
pub mod precision;
pub mod reassembly;
pub mod report;

use std::ffi::OsString;
use std::fmt;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use self::common::Common;
use self::lab::{Lab, Needs};
use self::report::Report;

/// What an experiment is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Name {
    /// How near hands and base come to held-out goals.
    Precision,
    /// What a disturbance does, and how soon it is over.
    Disturbance,
    /// Turning the base with an arm held or limp.
    ArmFailure,
    /// Turning bases of other masses.
    BaseMass,
    /// Some arms reach while the others hold the base.
    Reassembly,
    /// Errors against noise, disturbing torques, delay and mass of the arms.
    Noise,
}

impl Name {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Precision,
        Self::Disturbance,
        Self::ArmFailure,
        Self::BaseMass,
        Self::Reassembly,
        Self::Noise,
    ];

    /// As on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Precision => "precision",
            Self::Disturbance => "disturbance",
            Self::ArmFailure => "arm-failure",
            Self::BaseMass => "base-mass",
            Self::Reassembly => "reassembly",
            Self::Noise => "noise",
        }
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// One of the paper's experiments, with the options it was asked for with.
pub trait Experiment {
    /// What it is called.
    const NAME: Name;
    /// Which policies it needs.
    const NEEDS: Needs;
    /// Episodes of a setting, if none are asked for.
    const EPISODES: u32 = 30;
    /// What it has in its protocol besides what all share.
    type Settings: fmt::Debug + PartialEq + Serialize + DeserializeOwned;
    /// What it finds, one a case.
    type Result: fmt::Debug + Serialize + DeserializeOwned;

    /// The options that all share.
    fn common(&self) -> &Common;

    /// Its own options on the command line of `octopus experiment`.
    fn options(&self) -> Vec<OsString>;

    /// The command that does it, word by word.
    fn command(&self) -> Vec<OsString> {
        let command = ["octopus", "experiment", Self::NAME.as_str()].map(OsString::from);
        command.into_iter().chain(self.common().options()).chain(self.options()).collect()
    }

    /// Its settings in a lab.
    ///
    /// # Errors
    /// If it cannot be done so.
    fn settings(&self, lab: &Lab) -> anyhow::Result<Self::Settings>;

    /// How many steps of progress [`measure`](Self::measure) shows.
    fn work(&self, lab: &Lab) -> u64;

    /// Does it, with settings that were not refused.
    fn measure(&self, lab: &Lab) -> anyhow::Result<Vec<Self::Result>>;

    /// What it found as a person reads it, in lines of `columns` characters.
    fn table(columns: usize, report: &ReportOf<Self>) -> String;

    /// The same as its command prints it.
    fn printed(&self, columns: usize, report: &ReportOf<Self>) -> String {
        Self::table(columns, report)
    }
}

/// What an experiment's report holds.
pub type ReportOf<E> = Report<<E as Experiment>::Settings, <E as Experiment>::Result>;

/// Does an experiment in a lab that was made for it.
pub fn perform<E: Experiment>(experiment: &E, lab: &Lab) -> anyhow::Result<ReportOf<E>> {
    let settings = experiment.settings(lab)?;
    let results = experiment.measure(lab)?;
    Ok(lab.report(E::NAME, settings, results))
}
