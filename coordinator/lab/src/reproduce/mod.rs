//! All of the paper's experiments, and a page that shows them.
//!
//! Each experiment is done unless its file is there already, and written whole. The page
//! is made from the `Reports`; nothing of it is kept elsewhere, so it can be made again from the files.

mod claims;
mod drawing;
mod figures;
mod page;

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use proto::{ExitCode, ExitError};
use run::report::progress::Parts;
use serde::Serialize;
use store::provenance::Provenance;
use store::{files, outputs, regular_files};

pub use self::claims::{Claim, Tally, table};
use crate::experiments::command_line::typed;
use crate::experiments::common::Common;
use crate::experiments::lab::Lab;
use crate::experiments::report::RobotIdentity;
use crate::experiments::{Experiment, Name, ReportOf, perform};
use crate::experiments::{arm_failure, base_mass, disturbance, noise, precision, reassembly};
use crate::figures::recorded;
use crate::trained::PolicyIdentity;

/// Episodes of a setting with `--quick`.
const QUICK_EPISODES: u32 = 10;
/// Coarser settings with `--quick`.
const QUICK_MASSES: [f64; 5] = [100.0, 200.0, 400.0, 700.0, 1000.0];

/// The page's name in the directory.
const PAGE: &str = "report.html";
/// The name of the learning curves beside policies, as `octopus plot --save` writes them.
const CURVES: &str = "curves.json";
/// Stands in every page of ours, and so in none of others.
const GENERATOR: &str = "octopus reproduce";

/// Where runs land in the directory of everything.
pub const RUNS: &str = "runs";
/// Where the best policies do.
pub const POLICIES: &str = "policies";
/// The file beside them that says that they are.
pub const MARK: &str = ".octopus-reproduce";

/// What is asked of a reproduction.
#[derive(Debug, Clone)]
pub struct Study {
    /// A directory that holds `trajectory` and `reorientation`.
    pub policies: PathBuf,
    /// Runs, or files of learning curves, whose curves the page shows.
    pub curves: Vec<PathBuf>,
    /// Where everything goes.
    pub out: PathBuf,
    /// Fewer episodes and fewer settings.
    pub quick: bool,
    /// Episodes of a setting; as many as each experiment has by itself if none are given.
    pub episodes: Option<u32>,
    /// Control steps of an episode.
    pub steps: u32,
    /// Seed of goals and noise.
    pub seed: u64,
}

/// The page, and the paper's claims beside what was measured.
#[derive(Debug, Serialize)]
pub struct Reproduction {
    /// The page.
    pub report: PathBuf,
    /// The claims.
    pub claims: Vec<Claim>,
}

/// Refuses a directory that something else was made in, or a page that is none of ours.
pub fn check_place(out: &Path, force: bool) -> Result<(), ExitError> {
    check_page(&out.join(PAGE))?;
    outputs::check_directory("--out", out, is_ours, force)
}

/// The learning curves that lie beside policies, if there are any.
pub fn curves_beside(policies: &Path) -> Option<PathBuf> {
    Some(policies.join(CURVES)).filter(|curves| curves.is_file())
}

/// Does what is missing, draws, and says which claims hold.
pub fn reproduce(study: &Study) -> anyhow::Result<Reproduction> {
    let (curves, notes) = recorded::read_all(&study.curves)?;
    for note in &notes {
        output::note(note);
    }
    let planned = Planned::new(study)?;
    std::fs::create_dir_all(&study.out).map_err(|error| {
        let message = format!("{}: cannot be created: {error}", study.out.display());
        ExitError::new(ExitCode::RunDirectory, message)
    })?;
    let robot = planned.reassembly.lab.robot.clone();
    let commands = planned.commands();
    let reports = planned.finish()?;
    let claims = claims::claims(&reports);
    let html = page::page(&page::Content {
        reports: &reports,
        claims: &claims,
        commands: &commands,
        curves: &curves,
        robot: &robot,
        quick: study.quick,
    })?;
    let report = study.out.join(PAGE);
    files::replace(&report, html.as_bytes())?;
    Ok(Reproduction { report, claims })
}

impl Study {
    /// What all its experiments share.
    fn common(&self) -> Common {
        Common {
            policies: Some(self.policies.clone()),
            episodes: self.episodes.or(self.quick.then_some(QUICK_EPISODES)),
            steps: self.steps,
            seed: self.seed,
            ..Common::default()
        }
    }

    fn base_mass(&self) -> base_mass::Study {
        let study = base_mass::Study { common: self.common(), ..base_mass::Study::default() };
        if self.quick { base_mass::Study { masses: QUICK_MASSES.into(), ..study } } else { study }
    }

    fn noise(&self) -> noise::Study {
        let study = noise::Study { common: self.common(), ..noise::Study::default() };
        if !self.quick {
            return study;
        }
        noise::Study {
            sensors: vec![0.0, 5.0, 20.0, 50.0],
            torques: vec![0.0, 5.0, 20.0],
            arm_masses: vec![0.5, 1.0, 2.0, 3.0],
            ..study
        }
    }
}

/// What all experiments found.
#[derive(Debug)]
struct Reports {
    precision: ReportOf<precision::Study>,
    disturbance: ReportOf<disturbance::Study>,
    arm_failure: ReportOf<arm_failure::Study>,
    base_mass: ReportOf<base_mass::Study>,
    reassembly: ReportOf<reassembly::Study>,
    noise: ReportOf<noise::Study>,
}

/// The policies that come with the program: below the working directory, or above the program.
pub fn default_policies() -> Result<PathBuf, ExitError> {
    const PLACE: &str = "deploy/policies";
    let program = std::env::current_exe().unwrap_or_default();
    let mut places = std::iter::once(Path::new("")).chain(program.ancestors().skip(1));
    let found = places.find_map(|place| Some(place.join(PLACE)).filter(|place| place.is_dir()));
    found.ok_or_else(|| {
        let message = format!(
            "no policies: name a directory that holds `trajectory` and `reorientation` with \
             --policies DIR; there is no {PLACE} here or above the program. `octopus train \
             trajectory --run-dir DIR/trajectory` and `octopus train reorientation --run-dir \
             DIR/reorientation` make one"
        );
        ExitError::new(ExitCode::Usage, message)
    })
}

/// Whether a file or directory of this name in the directory is made here.
fn is_ours(name: &str) -> bool {
    let made = [PAGE, RUNS, POLICIES, MARK].contains(&name);
    made || Name::ALL.iter().any(|experiment| name == format!("{experiment}.json"))
}

/// Refuses to write over a page that is none of ours.
fn check_page(path: &Path) -> Result<(), ExitError> {
    let mark = format!("content=\"{GENERATOR}\"");
    match regular_files::read(path, regular_files::RECORD) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Ok(there) if String::from_utf8_lossy(&there).contains(&mark) => Ok(()),
        Ok(_) => Err(refused(path, "is there already and was not made by this command")),
        Err(error) => Err(refused(path, &format!("cannot be read: {error}"))),
    }
}

/// An error about something that stands in the way.
pub fn refused(path: &Path, what: &str) -> ExitError {
    let message = format!("{}: {what}; name another --out, or move it away", path.display());
    ExitError::new(ExitCode::RunDirectory, message)
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
fn same_policy(a: &PolicyIdentity, b: &PolicyIdentity) -> bool {
    let PolicyIdentity { checkpoint: _, ref policy_blake3, task, iteration, .. } = *a;
    (policy_blake3, task, iteration) == (&b.policy_blake3, b.task, b.iteration)
        && (a.digest, a.action_scale) == (b.digest, b.action_scale)
}

/// All of them.
struct Planned {
    precision: PlannedExperiment<precision::Study>,
    disturbance: PlannedExperiment<disturbance::Study>,
    arm_failure: PlannedExperiment<arm_failure::Study>,
    base_mass: PlannedExperiment<base_mass::Study>,
    reassembly: PlannedExperiment<reassembly::Study>,
    noise: PlannedExperiment<noise::Study>,
}

impl Planned {
    fn new(study: &Study) -> anyhow::Result<Self> {
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

    /// What makes each experiment's numbers.
    fn commands(&self) -> Vec<(Name, String)> {
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
    fn finish(self) -> anyhow::Result<Reports> {
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

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use super::*;

    fn small() -> Common {
        Common { episodes: Some(2), steps: 72, ..Common::default() }
    }

    fn made<E: Experiment>(experiment: &E) -> ReportOf<E> {
        perform(experiment, &experiment.resting_lab()).expect("a report")
    }

    /// What a robot that never moves by itself leads to.
    pub(super) fn reports() -> &'static Reports {
        static REPORTS: LazyLock<Reports> = LazyLock::new(|| {
            let common = small();
            Reports {
                precision: made(&precision::Study { common: common.clone(), agents: false }),
                disturbance: made(&disturbance::Study {
                    common: common.clone(),
                    at: 40,
                    ..disturbance::Study::default()
                }),
                arm_failure: made(&arm_failure::Study {
                    common: common.clone(),
                    ..arm_failure::Study::default()
                }),
                base_mass: made(&base_mass::Study {
                    common: common.clone(),
                    masses: vec![200.0, 400.0],
                    ..base_mass::Study::default()
                }),
                reassembly: made(&reassembly::Study {
                    common: common.clone(),
                    ..reassembly::Study::default()
                }),
                noise: made(&noise::Study {
                    common,
                    sensors: vec![0.0, 5.0],
                    torques: vec![0.0, 5.0],
                    delays: vec![0.0],
                    arm_masses: vec![1.0],
                }),
            }
        });
        &REPORTS
    }

    #[test]
    fn all_tables_fit() {
        let reports = reports();
        let Reports { precision, disturbance, arm_failure, base_mass, reassembly, noise } = reports;
        let columns = output::COLUMNS;
        for text in [
            precision::Study::table(columns, precision),
            disturbance::Study::table(columns, disturbance),
            arm_failure::Study::table(columns, arm_failure),
            base_mass::Study::table(columns, base_mass),
            reassembly::Study::table(columns, reassembly),
            noise::Study::table(columns, noise),
            claims::table(columns, &claims::claims(reports)),
        ] {
            for line in text.lines() {
                assert!(line.chars().count() <= columns, "{line}\nis too long in\n{text}");
            }
        }
    }

    #[test]
    fn the_page_names_commands_that_can_be_typed() {
        let study = Study {
            policies: "of mine/it's".into(),
            curves: Vec::new(),
            out: "x".into(),
            quick: true,
            episodes: None,
            steps: 200,
            seed: 3,
        };
        assert_eq!(
            typed(&study.base_mass().command()),
            "octopus experiment base-mass '--policies=of mine/it'\\''s' --episodes=10 --steps=200 \
             --seed=3 --masses=100,200,400,700,1000 --thresholds=0.01,0.02,0.03,0.05,0.1"
        );
    }

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
