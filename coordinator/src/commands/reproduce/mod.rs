//! `octopus reproduce`: all of the paper's experiments, and a page that shows them.
//!
//! Each experiment is asked for as on the command line of `octopus experiment`, done unless its file is there already, and written whole. The page
//! is made from the `Reports`; nothing of it is kept elsewhere, so it can be made again from the files.

mod claims;
mod drawing;
mod figures;
mod page;
mod training;

use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use anyhow::Context as _;
use clap::Parser as _;
use proto::{ExitCode, ExitError};
use serde::Serialize;

use self::claims::{Claim, Tally};
use crate::cli::experiment::{
    ArmFailureArgs, BaseMassArgs, DisturbanceArgs, ExperimentCommand, NoiseArgs, PrecisionArgs,
    ReassemblyArgs,
};
use crate::cli::reproduce::ReproduceArgs;
use crate::cli::{Cli, Command};
use crate::commands::experiment::lab::Lab;
use crate::commands::experiment::report::RobotIdentity;
use crate::commands::experiment::{Experiment, Name, ReportOf, perform};
use crate::commands::trained::PolicyIdentity;
use crate::figures::recorded;
use crate::provenance::{Provenance, utc};
use crate::report::progress::Parts;
use crate::{files, output, outputs, regular};

/// Episodes of a setting with `--quick`.
const QUICK_EPISODES: u32 = 10;
/// Coarser settings with `--quick`.
const QUICK_MASSES: &[&str] = &["--masses=100,200,400,700,1000"];
const QUICK_NOISE: &[&str] =
    &["--sensors=0,5,20,50", "--torques=0,5,20", "--delays=0,1,2", "--arm-masses=0.5,1,2,3"];

/// The page's name in the directory.
const PAGE: &str = "report.html";
/// The name of the learning curves beside policies, as `octopus plot --save` writes them.
const CURVES: &str = "curves.json";
/// Stands in every page of ours, and so in none of others.
const GENERATOR: &str = "octopus reproduce";

/// What all experiments found.
#[derive(Debug)]
struct Reports {
    precision: ReportOf<PrecisionArgs>,
    disturbance: ReportOf<DisturbanceArgs>,
    arm_failure: ReportOf<ArmFailureArgs>,
    base_mass: ReportOf<BaseMassArgs>,
    reassembly: ReportOf<ReassemblyArgs>,
    noise: ReportOf<NoiseArgs>,
}

/// What standard output says, as JSON.
#[derive(Debug, Serialize)]
struct Outcome<'a> {
    report: &'a Path,
    claims: &'a [Claim],
}

/// Does what is missing, draws, and says which claims hold.
pub fn run(args: &ReproduceArgs) -> anyhow::Result<()> {
    let now = utc(SystemTime::now()).compact();
    let out = args.out.clone().unwrap_or_else(|| format!("reproduction-{now}").into());
    let page = out.join(PAGE);
    check_page(&page)?;
    outputs::check_directory("--out", &out, is_ours, args.force)?;
    let (policies, runs) = if args.train {
        training::train(args, &out)?
    } else {
        let policies = args.policies.clone().map_or_else(default_policies, Ok)?;
        let shipped = policies.join(CURVES);
        let shipped = (args.runs.is_empty() && shipped.is_file()).then_some(shipped);
        (policies, args.runs.iter().cloned().chain(shipped).collect())
    };
    let (curves, notes) = recorded::read_all(&runs)?;
    for note in &notes {
        output::note(note);
    }
    let line = |name, quick: &[&str]| Line::new(name, args, &policies, quick);
    let jobs = Jobs {
        precision: Job::new(line(Name::Precision, &[]), &out, |command| match command {
            ExperimentCommand::Precision(args) => Some(args),
            _ => None,
        })?,
        disturbance: Job::new(line(Name::Disturbance, &[]), &out, |command| match command {
            ExperimentCommand::Disturbance(args) => Some(args),
            _ => None,
        })?,
        arm_failure: Job::new(line(Name::ArmFailure, &[]), &out, |command| match command {
            ExperimentCommand::ArmFailure(args) => Some(args),
            _ => None,
        })?,
        base_mass: Job::new(line(Name::BaseMass, QUICK_MASSES), &out, |command| match command {
            ExperimentCommand::BaseMass(args) => Some(args),
            _ => None,
        })?,
        reassembly: Job::new(line(Name::Reassembly, &[]), &out, |command| match command {
            ExperimentCommand::Reassembly(args) => Some(args),
            _ => None,
        })?,
        noise: Job::new(line(Name::Noise, QUICK_NOISE), &out, |command| match command {
            ExperimentCommand::Noise(args) => Some(args),
            _ => None,
        })?,
    };
    std::fs::create_dir_all(&out).map_err(|error| {
        let message = format!("{}: cannot be created: {error}", out.display());
        ExitError::new(ExitCode::RunDirectory, message)
    })?;
    let robot = jobs.reassembly.lab.robot.clone();
    let commands = jobs.commands();
    let reports = jobs.finish()?;
    let claims = claims::claims(&reports);
    let html = page::page(&page::Content {
        reports: &reports,
        claims: &claims,
        commands: &commands,
        curves: &curves,
        robot: &robot,
        quick: args.quick,
    })?;
    files::replace(&page, html.as_bytes())?;
    if args.json {
        return output::json(&Outcome { report: &page, claims: &claims });
    }
    let tally = Tally::of(&claims);
    output::line(&format!(
        "{}\n\n{} of {} claims hold{}\nreport      {}",
        claims::table(output::columns(), &claims),
        tally.hold,
        tally.of,
        tally.not_judged(),
        page.display()
    ))
}

/// The policies that come with the program: below the working directory, or above the program.
fn default_policies() -> Result<PathBuf, ExitError> {
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
    let made = [PAGE, training::RUNS, training::POLICIES].contains(&name);
    made || Name::ALL.iter().any(|experiment| name == format!("{experiment}.json"))
}

/// Refuses to write over a page that is none of ours.
fn check_page(path: &Path) -> Result<(), ExitError> {
    let mark = format!("content=\"{GENERATOR}\"");
    match regular::read(path, regular::RECORD) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Ok(there) if String::from_utf8_lossy(&there).contains(&mark) => Ok(()),
        Ok(_) => Err(refused(path, "is there already and was not made by this command")),
        Err(error) => Err(refused(path, &format!("cannot be read: {error}"))),
    }
}

fn refused(path: &Path, what: &str) -> ExitError {
    let message = format!("{}: {what}; name another --out, or move it away", path.display());
    ExitError::new(ExitCode::RunDirectory, message)
}

/// The command line of an experiment.
#[derive(Debug, Clone)]
struct Line(Vec<OsString>);

impl Line {
    fn new(name: Name, args: &ReproduceArgs, policies: &Path, quick: &[&str]) -> Self {
        let mut policies_flag = OsString::from("--policies=");
        policies_flag.push(policies);
        let mut words: Vec<OsString> =
            ["octopus", "experiment", name.as_str()].map(OsString::from).into();
        words.push(policies_flag);
        let episodes = args.episodes.or(args.quick.then_some(QUICK_EPISODES));
        words.extend(episodes.map(|episodes| format!("--episodes={episodes}").into()));
        words.push(format!("--steps={}", args.steps).into());
        words.push(format!("--seed={}", args.seed).into());
        if args.quick {
            words.extend(quick.iter().map(OsString::from));
        }
        Self(words)
    }

    fn parse(&self) -> anyhow::Result<ExperimentCommand> {
        match Cli::try_parse_from(&self.0)?.command {
            Command::Experiment(args) => Ok(args.command),
            other => unreachable!("{self:?} was read as {other:?}"),
        }
    }

    /// As a person would type it.
    fn text(&self) -> String {
        let words = self.0.iter().map(|word| {
            let word = word.to_string_lossy();
            let plain = |c: char| c.is_alphanumeric() || "-_=./,:+".contains(c);
            if word.chars().all(plain) {
                word.into_owned()
            } else {
                format!("'{}'", word.replace('\'', "'\\''"))
            }
        });
        words.collect::<Vec<_>>().join(" ")
    }
}

/// An experiment, and what was found of it already.
struct Job<E: Experiment> {
    experiment: E,
    line: Line,
    lab: Lab,
    path: PathBuf,
    found: Option<ReportOf<E>>,
}

impl<E: Experiment> Job<E> {
    /// Opens policies and checks settings; looks for a report that was made of the same.
    fn new(
        line: Line,
        out: &Path,
        pick: impl Fn(ExperimentCommand) -> Option<E>,
    ) -> anyhow::Result<Self> {
        let experiment = pick(line.parse()?).expect("the line names the experiment");
        let lab = Lab::new(&experiment)?;
        let settings = experiment.settings(&lab)?;
        let path = out.join(format!("{}.json", E::NAME));
        let found = find::<E>(&path, &lab, settings)?;
        Ok(Self { experiment, line, lab, path, found })
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
    let bytes = match regular::read(path, regular::RECORD) {
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
struct Jobs {
    precision: Job<PrecisionArgs>,
    disturbance: Job<DisturbanceArgs>,
    arm_failure: Job<ArmFailureArgs>,
    base_mass: Job<BaseMassArgs>,
    reassembly: Job<ReassemblyArgs>,
    noise: Job<NoiseArgs>,
}

impl Jobs {
    /// What makes each experiment's numbers.
    fn commands(&self) -> Vec<(Name, String)> {
        let lines = [
            (Name::Precision, &self.precision.line),
            (Name::Disturbance, &self.disturbance.line),
            (Name::ArmFailure, &self.arm_failure.line),
            (Name::BaseMass, &self.base_mass.line),
            (Name::Reassembly, &self.reassembly.line),
            (Name::Noise, &self.noise.line),
        ];
        lines.map(|(name, line)| (name, line.text())).into()
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

    fn made<E: Experiment>(
        line: &str,
        pick: impl Fn(ExperimentCommand) -> Option<E>,
    ) -> ReportOf<E> {
        let words = format!("octopus experiment {line} --episodes=2 --steps=72");
        let line = Line(words.split(' ').map(OsString::from).collect());
        let experiment = pick(line.parse().expect("valid")).expect("of this experiment");
        perform(&experiment, &Lab::resting(&experiment)).expect("a report")
    }

    /// What a robot that never moves by itself leads to.
    pub(super) fn reports() -> &'static Reports {
        static REPORTS: LazyLock<Reports> = LazyLock::new(|| Reports {
            precision: made("precision", |command| match command {
                ExperimentCommand::Precision(args) => Some(args),
                _ => None,
            }),
            disturbance: made("disturbance --at=40", |command| match command {
                ExperimentCommand::Disturbance(args) => Some(args),
                _ => None,
            }),
            arm_failure: made("arm-failure", |command| match command {
                ExperimentCommand::ArmFailure(args) => Some(args),
                _ => None,
            }),
            base_mass: made("base-mass --masses=200,400", |command| match command {
                ExperimentCommand::BaseMass(args) => Some(args),
                _ => None,
            }),
            reassembly: made("reassembly", |command| match command {
                ExperimentCommand::Reassembly(args) => Some(args),
                _ => None,
            }),
            noise: made("noise --sensors=0,5 --torques=0,5 --delays=0 --arm-masses=1", |command| {
                match command {
                    ExperimentCommand::Noise(args) => Some(args),
                    _ => None,
                }
            }),
        });
        &REPORTS
    }

    #[test]
    fn all_tables_fit() {
        let reports = reports();
        let Reports { precision, disturbance, arm_failure, base_mass, reassembly, noise } = reports;
        let columns = output::COLUMNS;
        for text in [
            PrecisionArgs::table(columns, precision),
            DisturbanceArgs::table(columns, disturbance),
            ArmFailureArgs::table(columns, arm_failure),
            BaseMassArgs::table(columns, base_mass),
            ReassemblyArgs::table(columns, reassembly),
            NoiseArgs::table(columns, noise),
            claims::table(columns, &claims::claims(reports)),
        ] {
            for line in text.lines() {
                assert!(line.chars().count() <= columns, "{line}\nis too long in\n{text}");
            }
        }
    }

    #[test]
    fn a_line_is_one_that_can_be_typed() {
        let cli = Cli::try_parse_from(["octopus", "reproduce", "--quick", "--seed=3"]);
        let Command::Reproduce(args) = cli.expect("valid").command else { panic!("another") };
        let line = Line::new(Name::BaseMass, &args, Path::new("of mine/it's"), QUICK_MASSES);
        assert_eq!(
            line.text(),
            "octopus experiment base-mass '--policies=of mine/it'\\''s' --episodes=10 \
             --steps=200 --seed=3 --masses=100,200,400,700,1000"
        );
        let ExperimentCommand::BaseMass(read) = line.parse().expect("valid") else { panic!() };
        assert_eq!(read.common.policies.as_deref(), Some(Path::new("of mine/it's")));
        assert_eq!(read.masses.0.len(), 5);
        assert!(matches!(
            Line::new(Name::Noise, &args, Path::new("x"), QUICK_NOISE).parse(),
            Ok(ExperimentCommand::Noise(_))
        ));
    }

    #[test]
    fn a_report_is_found_again_if_it_is_of_the_same() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("precision.json");
        let line = "octopus experiment precision --episodes=2 --steps=72";
        let parse = |line: &str| {
            let Command::Experiment(args) =
                Cli::try_parse_from(line.split(' ')).expect("valid").command
            else {
                panic!("another command")
            };
            let ExperimentCommand::Precision(args) = args.command else { panic!("another") };
            args
        };
        let find = |line: &str| {
            let experiment = parse(line);
            let lab = Lab::resting(&experiment);
            let settings = experiment.settings(&lab).expect("settings");
            super::find::<PrecisionArgs>(&path, &lab, settings)
        };
        assert!(find(line).expect("nothing there").is_none());
        let bytes = output::json_bytes(&reports().precision).expect("JSON");
        std::fs::write(&path, &bytes).expect("written");
        let found = find(line).expect("the same").expect("there");
        assert_eq!(found.protocol, reports().precision.protocol);
        let text = PrecisionArgs::table(output::COLUMNS, &found);
        assert_eq!(text, PrecisionArgs::table(output::COLUMNS, &reports().precision));
        let refusal = |line: &str| find(line).expect_err("refused").to_string();
        assert!(refusal(&format!("{line} --seed=1")).contains("made with other settings"));
        std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("written");
        assert!(refusal(line).contains("is no whole result"));
        let text = String::from_utf8(bytes).expect("UTF-8").replacen(
            "\"commit\": \"",
            "\"commit\": \"x",
            1,
        );
        std::fs::write(&path, text).expect("written");
        assert!(refusal(line).contains("made by another build"));
    }
}
