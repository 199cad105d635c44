//! A training that another command plans: asked for as on the command line of `octopus train`, in a directory of its own.
//!
//! Whoever plans several calls again what was stopped: finished ones are left as they are, and the others go on.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use clap::{Args, Parser};
use lab::reproduce::refused;
use proto::config::{Config, Precision, Run};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use store::checkpoint::{CheckpointStore, Manifest, flatten};
use store::recorded::Recorded;
use store::run_files::{read_config, read_robot};

use crate::train::{self, TrainArgs};

/// See the module.
#[derive(Debug, Clone)]
pub(crate) struct PlannedRun {
    /// Where it lands.
    pub(crate) dir: PathBuf,
    /// What it is asked for with: the words behind `octopus train`, without the directory.
    pub(crate) words: Vec<String>,
}

impl PlannedRun {
    /// Where it lands.
    pub(crate) fn run_dir(&self) -> RunDir {
        RunDir::new(&self.dir)
    }

    /// Whether there is something to go on with. A directory that holds results without a configuration, or of which that
    /// cannot be told, is refused: nobody may take it for one in which nothing has begun.
    pub(crate) fn has_begun(&self) -> Result<bool, ExitError> {
        let run_dir = self.run_dir();
        let config = run_dir.config();
        if is_there(&config)? {
            return Ok(true);
        }
        let checkpoints = run_dir.checkpoints();
        let has_checkpoints = match std::fs::read_dir(&checkpoints) {
            Ok(mut entries) => entries.next().is_some(),
            Err(error) if error.kind() == ErrorKind::NotFound => false,
            Err(error) => return Err(unreadable(&checkpoints, &error)),
        };
        if has_checkpoints || is_there(&run_dir.metrics_jsonl())? {
            let message = format!(
                "{}: is not there, but results of the run are; put it back from a copy (every checkpoint holds one), or move {} away",
                config.display(),
                self.dir.display()
            );
            return Err(ExitError::new(ExitCode::RunDirectory, message));
        }
        Ok(false)
    }

    /// The options of the `octopus train` that begins it.
    pub(crate) fn train_args(&self) -> Result<TrainArgs, clap::Error> {
        let dir = format!("--run-dir={}", self.dir.display());
        let words = ["octopus train".to_owned()].into_iter().chain(self.words.iter().cloned());
        options(words.chain([dir]))
    }

    /// The configuration that it is asked for with.
    pub(crate) fn config(&self) -> anyhow::Result<Config> {
        Ok(train::configure(&self.train_args()?)?)
    }

    /// Iterations that are recorded and from which it would go on.
    pub(crate) fn done(&self) -> anyhow::Result<u64> {
        let run_dir = self.run_dir();
        if !self.has_begun()? {
            return Ok(0);
        }
        let [own, _] = CheckpointStore::new(run_dir.checkpoints()).by_ownership()?;
        let committed = own.iter().filter_map(|dir| Manifest::read(dir).ok());
        let committed = committed.map(|manifest| manifest.iteration).max().unwrap_or(0);
        Ok(committed.min(Recorded::read(&run_dir)?.iterations()))
    }

    /// Whether all its iterations are done.
    pub(crate) fn is_finished(&self) -> anyhow::Result<bool> {
        Ok(self.has_begun()? && self.done()? >= read_config(&self.run_dir())?.planned_iterations())
    }

    /// Refuses a run of that name that is not the one that would be trained: somebody else's, or one that was asked for
    /// with other settings or another robot. Of what is harmless in group `run` the keys `also` matter here.
    pub(crate) fn check(&self, also: &[&str]) -> anyhow::Result<()> {
        if !self.has_begun()? {
            return Ok(());
        }
        let found = read_config(&self.run_dir())?;
        let mut wanted = self.config()?;
        if [wanted.run.precision, found.run.precision].contains(&Precision::Auto) {
            // Decided when the run began, by the processor.
            wanted.run.precision = found.run.precision;
        }
        let keys =
            |config: &Config| -> anyhow::Result<_> { Ok(flatten(&config.to_toml().parse()?)) };
        // As it would be written now; its name may be that of a file that has changed.
        let robot = wanted.robot.description.clone();
        let now = run::robots::load_robot(&robot)?.to_toml();
        let then = read_robot(&self.run_dir())?.0.to_toml();
        let (found, wanted) = (keys(&found)?, keys(&wanted)?);
        let matters = |key: &String| {
            let of_run = key.strip_prefix("run.");
            !of_run.is_some_and(|key| {
                key == "device" || Run::HARMLESS.contains(&key) && !also.contains(&key)
            })
        };
        let differs = |key: &&String| matters(key) && found.get(*key) != wanted.get(*key);
        if let Some(key) = found.keys().chain(wanted.keys()).find(differs) {
            let [found, wanted] =
                [&found, &wanted].map(|keys| keys.get(key).map_or("no value", String::as_str));
            let what = format!(
                "is a run already, with {found} as {key}, where this command wants {wanted}"
            );
            return Err(refused(&self.dir, &what).into());
        }
        if then != now {
            let (then, now) = (flatten(&then.parse()?), flatten(&now.parse()?));
            let differs = |key: &&String| then.get(*key) != now.get(*key);
            let keys: BTreeSet<&String> = then.keys().chain(now.keys()).filter(differs).collect();
            let keys: Vec<&str> = keys.into_iter().map(String::as_str).collect();
            let what = format!(
                "is a run already, of a robot that differs from {robot} as it is now in {}",
                keys.join(", ")
            );
            return Err(refused(&self.dir, &what).into());
        }
        Ok(())
    }
}

/// Whether something has this name.
fn is_there(path: &Path) -> Result<bool, ExitError> {
    path.try_exists().map_err(|error| unreadable(path, &error))
}

fn unreadable(path: &Path, error: &std::io::Error) -> ExitError {
    let message = format!("{}: cannot be looked at: {error}", path.display());
    ExitError::new(ExitCode::RunDirectory, message)
}

/// A command line of one command.
#[derive(Debug, Parser)]
struct Line<A: Args> {
    #[command(flatten)]
    options: A,
}

/// The options that a command line has. Its first word is the whole command.
pub(crate) fn options<A: Args>(words: impl IntoIterator<Item = String>) -> Result<A, clap::Error> {
    Line::try_parse_from(words).map(|line| line.options)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(dir: &std::path::Path, sets: &[&str]) -> PlannedRun {
        let words = ["trajectory", "--seed=1"].iter().chain(sets).map(ToString::to_string);
        PlannedRun { dir: dir.join("run"), words: words.collect() }
    }

    /// A directory with other runs may have been named, or other settings were asked for before.
    #[test]
    fn a_run_that_is_not_the_planned_one_is_not_gone_on_with() {
        let out = tempfile::tempdir().expect("tempdir");
        let asked = run(out.path(), &["--set=run.env_steps=6400", "--set=run.workers=3"]);
        let config = asked.config().expect("valid");
        assert!(asked.check(&[]).is_ok(), "it is still to be made");
        std::fs::create_dir_all(&asked.dir).expect("made");
        let robot = run::robots::load_robot(&config.robot.description).expect("built in");
        std::fs::write(asked.run_dir().robot(), robot.to_toml()).expect("written");
        // Decided when it began.
        for precision in [Precision::F32, Precision::Bf16] {
            let mut config = config.clone();
            config.run.precision = precision;
            std::fs::write(asked.run_dir().config(), config.to_toml()).expect("written");
            asked.check(&[]).expect("the same");
            // What changes nothing that is learned may differ.
            let harmless = ["--set=run.env_steps=6400", "--set=run.workers=1"];
            run(out.path(), &harmless).check(&[]).expect("the same");
        }
        for (sets, key) in [
            (&[][..], "run.env_steps"),
            (&["--set=run.env_steps=6400", "--set=network.hidden=[8]"], "network.hidden"),
        ] {
            let error = run(out.path(), sets).check(&[]).expect_err("another").to_string();
            assert!(error.contains("/run: is a run already"), "{error}");
            assert!(error.contains(key) && error.contains("another --out"), "{error}");
        }
        assert_eq!(asked.done().expect("readable"), 0);
    }

    /// A robot's file may change while its name, which the configuration has, stays.
    #[test]
    fn a_run_of_another_robot_is_not_gone_on_with() {
        let out = tempfile::tempdir().expect("tempdir");
        let file = out.path().join("robot.toml");
        let robot = run::robots::load_robot("paper").expect("built in").to_toml();
        std::fs::write(&file, &robot).expect("written");
        let asked = run(out.path(), &[&format!("--set=robot.description=\"{}\"", file.display())]);
        std::fs::create_dir_all(&asked.dir).expect("made");
        let config = asked.config().expect("valid");
        std::fs::write(asked.run_dir().config(), config.to_toml()).expect("written");
        std::fs::write(asked.run_dir().robot(), &robot).expect("written");
        asked.check(&[]).expect("the same");
        // What is no part of the robot may change.
        std::fs::write(&file, format!("# A comment.\n{robot}")).expect("written");
        asked.check(&[]).expect("the same");
        let moved = robot.replacen("home_position = [0.0", "home_position = [1.0", 1);
        assert_ne!(moved, robot);
        std::fs::write(&file, moved).expect("written");
        let error = asked.check(&[]).expect_err("another").to_string();
        assert!(error.contains("/run: is a run already, of a robot that differs"), "{error}");
        assert!(error.contains("as it is now in home_position; name another --out"), "{error}");
    }

    /// Whoever begins a run anew removes what is there.
    #[test]
    fn results_without_a_configuration_are_not_taken_for_nothing() {
        let out = tempfile::tempdir().expect("tempdir");
        let asked = run(out.path(), &[]);
        let run_dir = asked.run_dir();
        let begun = || asked.has_begun().map_err(|error| (error.code, error.message));
        assert_eq!(begun(), Ok(false), "there is no directory");
        // A kill may leave these before anything has begun.
        std::fs::create_dir_all(run_dir.checkpoints()).expect("made");
        std::fs::write(run_dir.robot(), "").expect("written");
        assert_eq!(begun(), Ok(false));
        let refused = |words: &str| {
            let (code, message) = begun().expect_err(words);
            assert_eq!(code, ExitCode::RunDirectory);
            assert!(message.contains("config.toml: ") && message.contains(words), "{message}");
            asked.check(&[]).expect_err(words);
        };
        std::fs::create_dir(run_dir.checkpoints().join("iteration-00000001")).expect("made");
        refused("results of the run are");
        std::fs::remove_dir_all(run_dir.checkpoints()).expect("removed");
        std::fs::write(run_dir.metrics_jsonl(), "").expect("written");
        refused("results of the run are");
        // A link to itself, of which nobody can tell where it leads.
        std::os::unix::fs::symlink("config.toml", run_dir.config()).expect("linked");
        refused("cannot be looked at");
        std::fs::remove_file(run_dir.config()).expect("removed");
        std::fs::write(run_dir.config(), "").expect("written");
        assert_eq!(begun(), Ok(true));
    }
}
