//! What every experiment has: options, a protocol, results, and a table of them.

use std::ffi::OsString;
use std::fmt;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::common::Common;
use super::lab::{Lab, Needs};
use super::name::Name;
use super::report::Report;

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

    /// Opens what its command line names.
    fn lab(&self) -> anyhow::Result<Lab> {
        Lab::new(self.common(), Self::NEEDS, Self::EPISODES)
    }

    /// The same with policies that do nothing.
    #[cfg(test)]
    fn resting_lab(&self) -> Lab {
        Lab::resting(self.common(), Self::NEEDS, Self::EPISODES)
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
