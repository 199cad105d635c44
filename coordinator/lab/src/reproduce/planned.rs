//! The experiments of a reproduction: each is done, unless its report is there already.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use proto::ExitError;
use run::report::progress::Parts;
use simulator::robot::Robot;
use store::provenance::Provenance;
use store::{files, regular_files};

use super::place::refused;
use super::reports::Reports;
use super::study::Study;
use crate::contender::Contender;
use crate::experiments::command_line::typed;
use crate::experiments::lab::Lab;
use crate::experiments::report::RobotIdentity;
use crate::experiments::{Experiment, Name, ReportOf, perform};
use crate::experiments::{arm_failure, base_mass, disturbance, noise, precision, reassembly};
use crate::identity::Identity;

/// All of them.
pub(super) struct Planned {
    precision: PlannedExperiment<precision::Study>,
    disturbance: PlannedExperiment<disturbance::Study>,
    arm_failure: PlannedExperiment<arm_failure::Study>,
    base_mass: PlannedExperiment<base_mass::Study>,
    reassembly: PlannedExperiment<reassembly::Study>,
    noise: PlannedExperiment<noise::Study>,
}

impl Planned {
    /// Opens and checks everything.
    pub(super) fn new(study: &Study) -> anyhow::Result<Self> {
        let (out, common) = (&study.out, || study.common());
        let disturbance = disturbance::Study { common: common(), ..disturbance::Study::default() };
        let arm_failure = arm_failure::Study { common: common(), ..arm_failure::Study::default() };
        let reassembly = reassembly::Study { common: common(), ..reassembly::Study::default() };
        Ok(Self {
            precision: PlannedExperiment::new(
                precision::Study { common: common(), agents: false },
                out,
            )?,
            disturbance: PlannedExperiment::new(disturbance, out)?,
            arm_failure: PlannedExperiment::new(arm_failure, out)?,
            base_mass: PlannedExperiment::new(study.base_mass(), out)?,
            reassembly: PlannedExperiment::new(reassembly, out)?,
            noise: PlannedExperiment::new(study.noise(), out)?,
        })
    }

    /// The robot of the policies.
    pub(super) fn robot(&self) -> &Robot {
        &self.reassembly.lab.robot
    }

    /// The policies, trajectory first.
    pub(super) fn policies(&self) -> &[Contender] {
        self.reassembly.lab.policies()
    }

    /// What makes each experiment's numbers.
    pub(super) fn commands(&self) -> Vec<(Name, String)> {
        vec![
            self.precision.command(),
            self.disturbance.command(),
            self.arm_failure.command(),
            self.base_mass.command(),
            self.reassembly.command(),
            self.noise.command(),
        ]
    }

    /// Does what is missing, under one bar.
    pub(super) fn finish(self) -> anyhow::Result<Reports> {
        let work = self.precision.work()
            + self.disturbance.work()
            + self.arm_failure.work()
            + self.base_mass.work()
            + self.reassembly.work()
            + self.noise.work();
        let progress = Arc::new(Parts::over(work));
        let reports = Reports {
            precision: self.precision.finish(&progress)?,
            disturbance: self.disturbance.finish(&progress)?,
            arm_failure: self.arm_failure.finish(&progress)?,
            base_mass: self.base_mass.finish(&progress)?,
            reassembly: self.reassembly.finish(&progress)?,
            noise: self.noise.finish(&progress)?,
        };
        progress.end();
        Ok(reports)
    }
}

/// An experiment, and what was found of it already.
struct PlannedExperiment<E: Experiment> {
    experiment: E,
    lab: Lab,
    path: PathBuf,
    found: Option<ReportOf<E>>,
}

impl<E: Experiment> PlannedExperiment<E> {
    /// Opens policies and checks settings; looks for a report that was made of the same.
    fn new(experiment: E, out: &Path) -> anyhow::Result<Self> {
        let lab = experiment.lab()?;
        let settings = experiment.settings(&lab)?;
        let path = out.join(format!("{}.json", E::NAME));
        let found = find::<E>(&path, &lab, settings)?;
        Ok(Self { experiment, lab, path, found })
    }

    /// The command that does it alone.
    fn command(&self) -> (Name, String) {
        (E::NAME, typed(&self.experiment.command()))
    }

    /// Steps of progress that are left.
    fn work(&self) -> u64 {
        if self.found.is_some() { 0 } else { self.experiment.work(&self.lab) }
    }

    /// Its report, made and written if there was none.
    fn finish(mut self, progress: &Arc<Parts>) -> anyhow::Result<ReportOf<E>> {
        if let Some(found) = self.found {
            return Ok(found);
        }
        self.lab.share_progress(progress);
        let report = perform(&self.experiment, &self.lab).with_context(|| E::NAME.to_string())?;
        files::replace(&self.path, &output::json_bytes(&report)?)?;
        Ok(report)
    }
}

/// The report at `path`, if there is a file: made as it would be now, or it is refused.
fn find<E: Experiment>(
    path: &Path,
    lab: &Lab,
    settings: E::Settings,
) -> Result<Option<ReportOf<E>>, ExitError> {
    let bytes = match regular_files::read(path, regular_files::RECORD) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(refused(path, &format!("cannot be read: {error}"))),
    };
    let found: ReportOf<E> = serde_json::from_slice(&bytes).map_err(|error| {
        let what = format!("is no whole result of `octopus experiment {}` ({error})", E::NAME);
        refused(path, &what)
    })?;
    let now = Provenance::gather();
    let made = |provenance: &Provenance| {
        let Provenance { version, commit, build, .. } = provenance;
        [version, commit, build].map(ToString::to_string)
    };
    let machine = |provenance: &Provenance| {
        (provenance.processor.clone(), provenance.vector_extensions.clone())
    };
    let policies = lab.identities();
    let same_policies = found.policies.len() == policies.len()
        && found.policies.iter().zip(&policies).all(|(a, b)| same_policy(a, b));
    let other = [
        (found.experiment == E::NAME, "of another experiment"),
        (found.protocol == lab.protocol(settings), "made with other settings"),
        (found.robot == RobotIdentity::of(&lab.robot), "made with another robot"),
        (same_policies, "made with other policies"),
        (made(&found.provenance) == made(&now), "made by another build"),
        (machine(&found.provenance) == machine(&now), "made on another processor"),
    ];
    let differences: Vec<&str> =
        other.iter().filter(|(same, _)| !same).map(|(_, what)| *what).collect();
    if differences.is_empty() {
        return Ok(Some(found));
    }
    Err(refused(path, &format!("is {}", differences.join(", and "))))
}

/// Whether two policies are the same, wherever they lie.
fn same_policy(a: &Identity, b: &Identity) -> bool {
    let Identity { checkpoint: _, ref policy_blake3, task, iteration, .. } = *a;
    (policy_blake3, task, iteration) == (&b.policy_blake3, b.task, b.iteration)
        && (a.digest, a.action_scale) == (b.digest, b.action_scale)
}

#[cfg(test)]
mod tests {
    use super::super::reports::tests::{reports, small};
    use super::*;
    use crate::experiments::common::Common;

    #[test]
    fn a_report_is_found_again_if_it_is_of_the_same() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("precision.json");
        let find = |seed: u64| {
            let experiment = precision::Study { common: Common { seed, ..small() }, agents: false };
            let lab = experiment.resting_lab();
            let settings = experiment.settings(&lab).expect("settings");
            super::find::<precision::Study>(&path, &lab, settings)
        };
        assert!(find(0).expect("nothing there").is_none());
        let bytes = output::json_bytes(&reports().precision).expect("JSON");
        std::fs::write(&path, &bytes).expect("written");
        let found = find(0).expect("the same").expect("there");
        assert_eq!(found.protocol, reports().precision.protocol);
        let text = precision::Study::table(output::COLUMNS, &found);
        assert_eq!(text, precision::Study::table(output::COLUMNS, &reports().precision));
        let refusal = |seed: u64| find(seed).expect_err("refused").to_string();
        assert!(refusal(1).contains("made with other settings"));
        std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("written");
        assert!(refusal(0).contains("is no whole result"));
        let text = String::from_utf8(bytes).expect("UTF-8").replacen(
            "\"commit\": \"",
            "\"commit\": \"x",
            1,
        );
        std::fs::write(&path, text).expect("written");
        assert!(refusal(0).contains("made by another build"));
    }
}
