//! `octopus experiment`: the paper's experiments, one file each.
//!
//! An `Experiment` is what its command line asks for. `perform` makes a `Report` of it, which is what `octopus experiment` prints and
//! what `octopus reproduce` writes and draws.

pub(crate) mod arm_failure;
pub(crate) mod base_mass;
pub(crate) mod disturbance;
pub(crate) mod lab;
pub(crate) mod noise;
pub(crate) mod precision;
pub(crate) mod reassembly;
pub(crate) mod report;

use std::fmt;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use self::lab::{Lab, Needs};
use self::report::Report;
use crate::cli::experiment::{CommonArgs, ExperimentArgs, ExperimentCommand};
use crate::output;

/// What an experiment is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Name {
    Precision,
    Disturbance,
    ArmFailure,
    BaseMass,
    Reassembly,
    Noise,
}

impl Name {
    /// All of them.
    pub(crate) const ALL: [Self; 6] = [
        Self::Precision,
        Self::Disturbance,
        Self::ArmFailure,
        Self::BaseMass,
        Self::Reassembly,
        Self::Noise,
    ];

    /// As on the command line.
    pub(crate) fn as_str(self) -> &'static str {
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
pub(crate) trait Experiment {
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
    fn common(&self) -> &CommonArgs;

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
pub(crate) type ReportOf<E> = Report<<E as Experiment>::Settings, <E as Experiment>::Result>;

/// Runs one and prints.
pub fn run(args: &ExperimentArgs) -> anyhow::Result<()> {
    match &args.command {
        ExperimentCommand::Precision(args) => print(args),
        ExperimentCommand::Disturbance(args) => print(args),
        ExperimentCommand::ArmFailure(args) => print(args),
        ExperimentCommand::BaseMass(args) => print(args),
        ExperimentCommand::Reassembly(args) => print(args),
        ExperimentCommand::Noise(args) => print(args),
    }
}

fn print<E: Experiment>(experiment: &E) -> anyhow::Result<()> {
    let lab = Lab::new(experiment)?;
    let report = perform(experiment, &lab)?;
    lab.end();
    if experiment.common().json {
        return output::json(&report);
    }
    output::line(&experiment.printed(output::columns(), &report))
}

/// Does an experiment in a lab that was made for it.
pub(crate) fn perform<E: Experiment>(experiment: &E, lab: &Lab) -> anyhow::Result<ReportOf<E>> {
    let settings = experiment.settings(lab)?;
    let results = experiment.measure(lab)?;
    Ok(lab.report(E::NAME, settings, results))
}
