//! Where everything of a sweep is, and that nobody else uses it.
//!
//! ```text
//! sweeps/rates/
//!   sweep.toml      the sweep as it was last asked for
//!   trials/         one run directory a trial
//!   records/        what is known of each beside that: scores, failures, and what its processes say
//!   table.csv       all trials
//!   report.html     the page
//!   sweep.lock      held while the sweep is under way
//! ```

use std::fs::File;
use std::io::ErrorKind;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use lab::sweep::page::GENERATOR;
use lab::sweep::record::Record;
use proto::{ExitCode, ExitError};
use run::errors;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use serde::Deserialize;
use store::regular_files::{self, Links};
use store::{files, outputs, owned_files};
use toml::{Spanned, Value};

use super::file::SweepFile;
use super::plan::Plan;

/// Where trials land.
const TRIALS: &str = "trials";
const SWEEP: &str = "sweep.toml";
const RECORDS: &str = "records";
const TABLE: &str = "table.csv";
const PAGE: &str = "report.html";
const LOCK: &str = "sweep.lock";

/// What the copy of the file begins with.
const MARK: &str = "# Copied by `octopus sweep`; change the file that it is of.\n";

/// The directory of a sweep.
#[derive(Debug, Clone)]
pub(super) struct Place(PathBuf);

/// Whoever has it may train.
#[derive(Debug)]
pub(super) struct Held {
    _sweep: File,
    _trial: Option<File>,
}

impl Place {
    /// Where `file` lands, unless somebody says otherwise.
    pub(super) fn of(file: &Path, out: Option<&Path>) -> Self {
        let own = || Path::new("sweeps").join(file.file_stem().unwrap_or_default());
        Self(out.map_or_else(own, Path::to_owned))
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }

    /// Where the runs of trials land.
    pub(super) fn trials(&self) -> PathBuf {
        self.0.join(TRIALS)
    }

    pub(super) fn table(&self) -> PathBuf {
        self.0.join(TABLE)
    }

    pub(super) fn page(&self) -> PathBuf {
        self.0.join(PAGE)
    }

    /// What is known of a trial.
    pub(super) fn record(&self, trial: &str) -> PathBuf {
        self.0.join(RECORDS).join(format!("{trial}.json"))
    }

    /// What its processes say.
    pub(super) fn log(&self, trial: &str) -> PathBuf {
        self.0.join(RECORDS).join(format!("{trial}.log"))
    }

    /// Refuses a directory in which no sweep has begun.
    pub(super) fn check_begun(&self) -> anyhow::Result<()> {
        if self.0.join(SWEEP).is_file() {
            return Ok(());
        }
        let what = "no sweep has begun there; the same command without --table begins it, --dry-run shows its trials";
        Err(refused(&self.0, what).into())
    }

    /// Refuses a directory that something else was made in, and one of another sweep. Trials may be added to a sweep; what has
    /// begun may neither change nor be left out.
    pub(super) fn check(&self, plan: &Plan) -> anyhow::Result<()> {
        // By its file a directory is known for a sweep's; people lay notes and pictures beside it.
        let is_ours = self.0.join(SWEEP).is_file();
        outputs::check_directory("--out", &self.0, |_| is_ours, None)?;
        if !is_ours {
            return Ok(());
        }
        let copy = self.0.join(SWEEP);
        let text = regular_files::read_text(&copy, regular_files::TEXT)
            .map_err(|error| refused(&copy, &format!("cannot be read: {error}")))?;
        let Some(text) = text.strip_prefix(MARK) else {
            return Err(refused(&copy, "was not made by this command").into());
        };
        let before = SweepFile::parse(&copy, text.to_owned())?;
        let (then, now) = (&before, &plan.file);
        if then.halving != now.halving {
            return Err(self.changed(now, "[halving]").into());
        }
        if then.evaluation != now.evaluation {
            return Err(self.changed(now, "[evaluation]").into());
        }
        for (run, trial) in plan.runs.iter().zip(&plan.study.trials) {
            // Harmless to a run, and what rungs compare.
            let compared: &[&str] = match now.halving {
                Some(_) => &["evaluation_episodes", "evaluation_steps"],
                None => &[],
            };
            run.check(compared).map_err(|error| {
                let message = format!("trial {}: {}", trial.name, errors::told(&error));
                ExitError::new(errors::exit_code(&error), message)
            })?;
        }
        let begun = self.begun();
        let is_planned = |name: &String| plan.study.trials.iter().any(|trial| trial.name == *name);
        if let Some(name) = begun.iter().find(|name| !is_planned(name)) {
            let message = format!(
                "{}: trial {name} of {} is not in it any more; put it back, or name another --out",
                now.path.display(),
                self.0.display()
            );
            return Err(ExitError::new(ExitCode::RunDirectory, message).into());
        }
        let page = self.page();
        match regular_files::read(&page, regular_files::RECORD) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
            Ok(there)
                if String::from_utf8_lossy(&there)
                    .contains(&format!("content=\"{GENERATOR}\"")) =>
            {
                Ok(())
            }
            _ => Err(refused(&page, "was not made by this command").into()),
        }
    }

    /// The names of the trials that have directories. Beside them lies what other programs keep there: a service its token, a
    /// file manager its notes. No trial's name begins with a dot.
    fn begun(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.trials()).into_iter().flatten().flatten();
        let mut begun: Vec<String> = entries
            .filter(|entry| entry.path().is_dir())
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .filter(|name| !name.starts_with('.'))
            .collect();
        begun.sort();
        begun
    }

    fn changed(&self, now: &SweepFile, group: &str) -> ExitError {
        let message = format!(
            "{}: {group} is another than that of {}, by which its trials were scored; put it back, or name another --out",
            now.path.display(),
            self.0.join(SWEEP).display()
        );
        ExitError::new(ExitCode::RunDirectory, message)
    }

    /// Makes it, if it is not there, and keeps a copy of the sweep's file. Nobody else may train in it meanwhile: all of it, or
    /// one `trial`.
    pub(super) fn open(&self, plan: &Plan, trial: Option<&str>) -> anyhow::Result<Held> {
        let create = |dir: &Path| {
            std::fs::create_dir_all(dir).map_err(|error| {
                let message = format!("{}: cannot be created: {error}", dir.display());
                ExitError::new(ExitCode::RunDirectory, message)
            })
        };
        create(&self.0)?;
        // The file may be such a copy itself.
        let text = plan.file.text.strip_prefix(MARK).unwrap_or(&plan.file.text);
        let copy = [MARK, &standing_anywhere(text, &plan.file)].concat();
        let own = self.0.join(SWEEP);
        if !own.exists() {
            // Before all else: by it the rest is known to be ours, also after a kill.
            files::replace(&own, copy.as_bytes())?;
        }
        create(&self.trials())?;
        create(&self.0.join(RECORDS))?;
        let kind = match trial {
            None => FlockOperation::NonBlockingLockExclusive,
            Some(_) => FlockOperation::NonBlockingLockShared,
        };
        let sweep = lock(&self.0.join(LOCK), kind)?;
        let of_trial = |trial: &str| {
            let path = self.0.join(RECORDS).join(format!("{trial}.lock"));
            lock(&path, FlockOperation::NonBlockingLockExclusive)
        };
        let trial = trial.map(of_trial).transpose()?;
        // Tasks of a job array have the same file, and need not write it one after the other.
        let is_there = regular_files::read(&own, regular_files::TEXT)
            .is_ok_and(|there| there == copy.as_bytes());
        if !is_there {
            files::replace(&own, copy.as_bytes())?;
        }
        Ok(Held { _sweep: sweep, _trial: trial })
    }

    /// What is known of all trials.
    pub(super) fn records(&self, plan: &Plan) -> Vec<Record> {
        let read =
            |trial: &lab::sweep::study::Trial| Record::of(&self.record(&trial.name), &trial.run);
        plan.study.trials.iter().map(read).collect()
    }
}

/// The text of a sweep's file with its `config`, which is looked for beside it, by its whole path, so that the copy is a sweep, too.
fn standing_anywhere(text: &str, file: &SweepFile) -> String {
    #[derive(Deserialize)]
    struct Own {
        config: Option<Spanned<String>>,
    }
    let whole = file.config.as_ref().and_then(|config| config.canonicalize().ok());
    let written = toml::from_str::<Own>(text).ok().and_then(|own| own.config);
    let mut text = text.to_owned();
    if let (Some(whole), Some(written)) = (whole.as_ref().and_then(|whole| whole.to_str()), written)
    {
        text.replace_range(written.span(), &Value::from(whole).to_string());
    }
    text
}

/// Locks a file; the kernel lets go of it when the process ends.
fn lock(path: &Path, kind: FlockOperation) -> Result<File, ExitError> {
    let fail = |what: String| {
        ExitError::new(ExitCode::RunDirectory, format!("{}: {what}", path.display()))
    };
    let mut options = File::options();
    options.write(true).create(true).truncate(false).mode(owned_files::MODE);
    let file = regular_files::open_with(path, &mut options, Links::Refuse)
        .map_err(|error| fail(format!("cannot be written: {error}; name another --out")))?;
    flock(&file, kind).map_err(|error| match error {
        Errno::WOULDBLOCK => {
            fail("a sweep is under way here; wait for its end, or stop it first".to_owned())
        }
        error => {
            fail(format!("cannot be locked: {error}; name an --out on a disk that knows locks"))
        }
    })?;
    Ok(file)
}

fn refused(path: &Path, what: &str) -> ExitError {
    lab::reproduce::refused(path, what)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: &str = "iterations = 4\n[grid]\nalgorithm.gamma = [0.9, 0.95]";

    /// A place in which a sweep has begun, and its plan.
    fn begun(out: &Path) -> (Place, Plan) {
        let place = Place::of(Path::new("rates.toml"), Some(out));
        let file = SweepFile::parse(Path::new("rates.toml"), GRID.to_owned()).expect("valid");
        let plan = Plan::new(file, &place.trials()).expect("valid");
        drop(place.open(&plan, None).expect("nobody else is there"));
        std::fs::create_dir(place.trials().join("gamma=0.9,seed=1")).expect("made");
        (place, plan)
    }

    /// `octopus serve` keeps its token there.
    #[test]
    fn trials_are_directories_without_a_dot() {
        let out = tempfile::tempdir().expect("tempdir");
        let (place, plan) = begun(out.path());
        std::fs::write(place.trials().join(".http.token"), "x").expect("written");
        std::fs::write(place.trials().join("notes.txt"), "x").expect("written");
        std::fs::create_dir(place.trials().join(".cache")).expect("made");
        place.check(&plan).expect("no other trial");
        std::fs::create_dir(place.trials().join("gamma=0.5,seed=1")).expect("made");
        let told = place.check(&plan).expect_err("another trial").to_string();
        assert!(told.contains("trial gamma=0.5,seed=1 of"), "{told}");
    }

    #[test]
    fn notes_beside_a_sweep_are_nothing_to_it() {
        let out = tempfile::tempdir().expect("tempdir");
        let (place, plan) = begun(out.path());
        std::fs::write(out.path().join("notes.txt"), "x").expect("written");
        place.check(&plan).expect("its own directory");
        std::fs::remove_file(out.path().join(SWEEP)).expect("removed");
        let told = place.check(&plan).expect_err("anybody's directory").to_string();
        assert!(told.contains("holds \"notes.txt\"") && !told.contains("--force"), "{told}");
    }

    #[test]
    fn the_copy_of_a_sweep_is_one_itself() {
        let dir = tempfile::tempdir().expect("tempdir");
        let config = dir.path().join("cfg.toml");
        std::fs::write(&config, "").expect("written");
        let path = dir.path().join("rates.toml");
        let text = "seeds = [1]\n config = \"cfg.toml\" # mine\n[set]\nconfig = 1\n";
        let config_of = |path: &Path, text: &str| {
            let text = text.replace("[set]\nconfig = 1\n", "");
            SweepFile::parse(path, text).expect("valid").config.expect("one")
        };
        let file = SweepFile {
            config: Some(config.clone()),
            ..SweepFile::parse(&path, String::new()).expect("valid")
        };
        let copy = standing_anywhere(text, &file);
        assert!(
            copy.starts_with("seeds = [1]\n") && copy.ends_with(" # mine\n[set]\nconfig = 1\n"),
            "{copy}"
        );
        let whole = config.canonicalize().expect("there");
        assert_eq!(config_of(Path::new("elsewhere/sweep.toml"), &copy), whole);
        assert_eq!(standing_anywhere("seeds = [1]", &file), "seeds = [1]");
    }
}
