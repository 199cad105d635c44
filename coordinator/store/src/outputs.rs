//! What a command may write over: nothing that it read, and without `--force` nothing that others made.
//!
//! A file that is there already is replaced if it is empty or begins as the files of its command do, as one that a
//! command made before. What lies in a run or a checkpoint belongs to that.

use std::fs::{File, Metadata};
use std::io::Read as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};

use crate::checkpoint::MANIFEST;
use crate::files;

/// A file that a command is asked to write.
#[derive(Debug, Clone, Copy)]
pub struct Output<'a> {
    /// The flag that names it.
    pub flag: &'static str,
    /// Where it goes.
    pub path: &'a Path,
    /// What files of its command begin with; empty if they cannot be told from others.
    pub mark: &'a [u8],
    /// Whether it may replace what others made.
    pub force: bool,
}

/// What a command reads: the flag or argument that names it, and its place.
pub type Input<'a> = (&'static str, &'a Path);

impl Output<'_> {
    /// Like [`Self::check`], of a command that writes standard output where it is told `-`.
    pub fn check_or_stdout(&self, inputs: &[Input<'_>]) -> Result<(), ExitError> {
        if self.path == Path::new("-") { Ok(()) } else { self.check(inputs) }
    }

    /// Refuses a place that is taken, and `-`, which others take for standard output. Terminals and pipes are no places.
    pub fn check(&self, inputs: &[Input<'_>]) -> Result<(), ExitError> {
        let Self { flag, path, mark, force } = *self;
        let shown = path.display();
        if path == Path::new("-") {
            let message =
                format!("{flag} -: this goes into a file; name one, `./-` if that is its name");
            return Err(ExitError::new(ExitCode::Usage, message));
        }
        let there = path.metadata().ok();
        if there.as_ref().is_some_and(|there| !there.is_file() && !there.is_dir()) {
            return Ok(());
        }
        if let Some(there) = &there {
            let input = inputs.iter().find(|(_, input)| is(input, there));
            if let Some((name, _)) = input {
                let message = format!("{flag} {shown}: is what {name} reads; name another file");
                return Err(ExitError::new(ExitCode::Usage, message));
            }
            if there.is_dir() {
                return Err(refused(format!("{flag} {shown}: is a directory; name a file")));
            }
        }
        if force {
            // What was read is not lost even then: a run that a picture is drawn of, say.
            let read_from =
                inputs.iter().find(|(_, input)| input.is_dir() && is_below(path, input));
            return match (there, read_from) {
                (Some(there), Some((_, input))) if !made_by(path, &there, mark) => {
                    let message = format!("belongs to {}, which is read", input.display());
                    Err(refused(format!("{flag} {shown}: {message}; name another file")))
                }
                _ => self.check_place(),
            };
        }
        if let Some((owner, kind)) = owner(path) {
            return Err(refused(format!(
                "{flag} {shown}: lies in {}, which is {kind}; name another place, or use --force",
                owner.display()
            )));
        }
        match there {
            Some(there) if !made_by(path, &there, mark) => Err(refused(format!(
                "{flag} {shown}: is there already{}; --force writes over it",
                if mark.is_empty() { "" } else { " and was not made by this command" }
            ))),
            _ => self.check_place(),
        }
    }

    /// Refuses a file in a directory that is not there or takes none, as writing it would, but before the work.
    fn check_place(&self) -> Result<(), ExitError> {
        check_place(self.flag, self.path)
    }
}

fn check_place(flag: &str, path: &Path) -> Result<(), ExitError> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    let reason = match parent.filter(|parent| !parent.is_dir()) {
        Some(parent) => format!("{} is no directory", parent.display()),
        None => match files::try_place(path) {
            Ok(()) => return Ok(()),
            Err(error) => error.to_string(),
        },
    };
    let message = format!("{flag} {}: cannot be written: {reason}", path.display());
    Err(ExitError::new(ExitCode::Failure, message))
}

/// Refuses a file name that promises another format than the one that is written.
pub fn check_ending(flag: &str, path: &Path, ending: &str) -> Result<(), ExitError> {
    // What has no ending promises nothing, as `/dev/stdout`, also where that is a file.
    let Some(there) = path.extension() else { return Ok(()) };
    let is_place = path.metadata().is_ok_and(|there| !there.is_file() && !there.is_dir());
    if is_place || there.eq_ignore_ascii_case(ending) {
        return Ok(());
    }
    let message = format!("{flag} {}: wants a name that ends in .{ending}", path.display());
    Err(ExitError::new(ExitCode::Usage, message))
}

/// Refuses a place for a new directory inside a run or a checkpoint.
pub fn check_outside(flag: &str, path: &Path) -> Result<(), ExitError> {
    let Some((owner, kind)) = owner(path) else { return Ok(()) };
    Err(refused(format!(
        "{flag} {}: lies in {}, which is {kind}; name another place",
        path.display(),
        owner.display()
    )))
}

/// Refuses a place for a directory that a command makes whole, if something is there or nothing can be made there.
pub fn check_new_directory(flag: &str, path: &Path) -> Result<(), ExitError> {
    check_outside(flag, path)?;
    if path.symlink_metadata().is_ok() {
        let message = format!("{flag} {}: is there already; name another place", path.display());
        return Err(refused(message));
    }
    check_place(flag, path)
}

/// Refuses a directory that holds anything else than what `ours` names, or that is a run or a checkpoint or lies
/// in one. `force` allows other things beside what a command makes; none if the command has no such flag.
pub fn check_directory(
    flag: &str,
    path: &Path,
    ours: impl Fn(&str) -> bool,
    force: Option<bool>,
) -> Result<(), ExitError> {
    let shown = path.display();
    if let Some(kind) = kind(path) {
        return Err(refused(format!("{flag} {shown}: is {kind}; name another directory")));
    }
    check_outside(flag, path)?;
    if path.exists() && !path.is_dir() {
        return Err(refused(format!("{flag} {shown}: is no directory; name another one")));
    }
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut others: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    others.retain(|name| !ours(name) && !is_temporary(name));
    others.sort();
    let Some(other) = others.first().filter(|_| force != Some(true)) else { return Ok(()) };
    let forced = if force.is_some() { ", or use --force" } else { "" };
    Err(refused(format!(
        "{flag} {shown}: holds {other:?}, which this command did not make; name another \
         directory{forced}"
    )))
}

/// Whether a name is that of a file that a kill left before it took its place.
fn is_temporary(name: &str) -> bool {
    name.starts_with('.') && Path::new(name).extension().is_some_and(|ending| ending == "tmp")
}

fn refused(message: String) -> ExitError {
    ExitError::new(ExitCode::RunDirectory, message)
}

/// Whether `path` leads to the very file; `-` to what standard input is read from.
fn is(path: &Path, file: &Metadata) -> bool {
    if path == Path::new("-") {
        let input = rustix::fs::fstat(std::io::stdin());
        return input.is_ok_and(|input| (input.st_dev, input.st_ino) == (file.dev(), file.ino()));
    }
    path.metadata().is_ok_and(|other| (other.dev(), other.ino()) == (file.dev(), file.ino()))
}

/// Refuses JSON on standard output where a table goes there.
pub fn check_stdout(json: bool, table: Option<&Path>) -> Result<(), ExitError> {
    if json && table == Some(Path::new("-")) {
        let message = "--json: standard output has what `--out -` writes; name a file by --out";
        return Err(ExitError::new(ExitCode::Usage, message));
    }
    Ok(())
}

/// Refuses two outputs of one command that are one file; each is given with the flag that names it.
pub fn check_distinct(outputs: &[(&'static str, &Path)]) -> Result<(), ExitError> {
    for (index, (flag, path)) in outputs.iter().enumerate() {
        let mut before = outputs[..index].iter();
        if let Some((other, _)) = before.find(|(_, other)| is_same_place(path, other)) {
            let message =
                format!("{flag} {}: is what {other} writes; name another file", path.display());
            return Err(ExitError::new(ExitCode::Usage, message));
        }
    }
    Ok(())
}

/// Whether two names are of one file, which may be still to be made.
fn is_same_place(one: &Path, other: &Path) -> bool {
    if let Ok(there) = one.metadata() {
        return is(other, &there);
    }
    let whole = |path: &Path| {
        let parent = path.parent()?;
        let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
        Some(parent.canonicalize().ok()?.join(path.file_name()?))
    };
    one == other || (whole(one).is_some() && whole(one) == whole(other))
}

/// Whether a file may be replaced by another of its kind.
fn made_by(path: &Path, there: &Metadata, mark: &[u8]) -> bool {
    let mut begin = vec![0; mark.len()];
    let mut read = || File::open(path)?.read_exact(&mut begin);
    there.len() == 0 || (!mark.is_empty() && read().is_ok() && begin == mark)
}

/// What a directory is, if it is one whose files belong together.
fn kind(dir: &Path) -> Option<&'static str> {
    let run = RunDir::new(dir);
    if dir.join(MANIFEST).is_file() && run.robot().is_file() {
        return Some("a checkpoint");
    }
    (run.config().is_file() && run.robot().is_file()).then_some("a run directory")
}

/// The run or the checkpoint in which a path lies, or would.
fn owner(path: &Path) -> Option<(PathBuf, &'static str)> {
    let parent = path.parent()?;
    let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
    // Also above places that are still to be made.
    let there = parent.ancestors().find_map(|above| above.canonicalize().ok())?;
    there.ancestors().find_map(|above| Some((above.to_owned(), kind(above)?)))
}

fn is_below(path: &Path, dir: &Path) -> bool {
    let whole = |path: &Path| path.canonicalize();
    matches!((whole(path), whole(dir)), (Ok(path), Ok(dir)) if path.starts_with(&dir))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MARK: &[u8] = b"<svg";

    /// A directory with a file of somebody's, a picture, and a run.
    fn place() -> tempfile::TempDir {
        let place = tempfile::tempdir().expect("tempdir");
        let run = RunDir::new(place.path().join("run"));
        std::fs::create_dir(run.path()).expect("made");
        for (path, text) in [
            (place.path().join("in.csv"), "1,2\n"),
            (place.path().join("old.svg"), "<svg></svg>"),
            (place.path().join("empty"), ""),
            (run.config(), "[run]"),
            (run.robot(), "name = \"x\""),
            (run.curve(), "<svg></svg>"),
        ] {
            std::fs::write(path, text).expect("written");
        }
        place
    }

    fn check(path: &Path, force: bool, inputs: &[Input<'_>]) -> Result<(), (ExitCode, String)> {
        let output = Output { flag: "--out", path, mark: MARK, force };
        output.check(inputs).map_err(|error| (error.code, error.message))
    }

    #[test]
    fn what_was_read_is_never_written_over_under_any_name() {
        let place = place();
        let at = |name: &str| place.path().join(name);
        std::fs::hard_link(at("in.csv"), at("hard")).expect("linked");
        std::os::unix::fs::symlink(at("in.csv"), at("soft")).expect("linked");
        let read = at("in.csv");
        for name in ["in.csv", "hard", "soft", "run/../in.csv"] {
            for force in [false, true] {
                let (code, message) =
                    check(&at(name), force, &[("--actions", &read)]).expect_err("it would be lost");
                assert_eq!(code, ExitCode::Usage);
                assert!(message.contains("is what --actions reads"), "{message}");
            }
        }
    }

    #[test]
    fn one_place_has_many_names() {
        let place = place();
        let at = |name: &str| place.path().join(name);
        std::os::unix::fs::symlink(at("in.csv"), at("soft")).expect("linked");
        for (one, other) in
            [("new", "./new"), ("new", "run/../new"), ("in.csv", "soft"), ("none/x", "none/x")]
        {
            assert!(is_same_place(&at(one), &at(other)), "{one} and {other}");
        }
        for (one, other) in [("new", "other"), ("in.csv", "empty"), ("new", "run/new")] {
            assert!(!is_same_place(&at(one), &at(other)), "{one} and {other}");
        }
    }

    #[test]
    fn two_outputs_are_two_files() {
        let place = place();
        let at = |name: &str| place.path().join(name);
        let (new, same, other) = (at("new"), at("run/../new"), at("other"));
        assert!(check_distinct(&[("--out", &new), ("--csv", &other)]).is_ok());
        let outputs = [("--out", &*other), ("--picture", &*new), ("--csv", &*same)];
        let error = check_distinct(&outputs).expect_err("one would be lost");
        assert_eq!(error.code, ExitCode::Usage);
        assert!(error.message.starts_with("--csv ") && error.message.contains("--picture writes"));
    }

    #[test]
    fn what_others_made_is_replaced_by_force_only() {
        let place = place();
        let at = |name: &str| place.path().join(name);
        for free in ["new.svg", "old.svg", "empty"] {
            assert_eq!(check(&at(free), false, &[]), Ok(()), "{free}");
        }
        let (code, message) = check(&at("in.csv"), false, &[]).expect_err("not a picture");
        assert_eq!(code, ExitCode::RunDirectory);
        assert!(message.contains("not made by this command; --force"), "{message}");
        assert_eq!(check(&at("in.csv"), true, &[]), Ok(()));
        assert!(check(place.path(), true, &[]).is_err(), "a directory is no file");
        assert_eq!(check(Path::new("/dev/null"), false, &[]), Ok(()));
        for force in [false, true] {
            let (code, message) = check(Path::new("-"), force, &[]).expect_err("no file");
            assert_eq!(code, ExitCode::Usage);
            assert!(message.contains("name one, `./-` if"), "{message}");
            let output = Output { flag: "--out", path: Path::new("-"), mark: MARK, force };
            assert!(output.check_or_stdout(&[]).is_ok());
        }
    }

    #[test]
    fn a_file_wants_a_directory_that_is_there() {
        let place = place();
        for wrong in ["none/new.svg", "in.csv/new.svg", "run/none/new.svg"] {
            let (code, message) = check(&place.path().join(wrong), true, &[]).expect_err(wrong);
            assert_eq!(code, ExitCode::Failure);
            assert!(message.contains("cannot be written") && message.contains("is no directory"));
        }
        assert!(check(&place.path().join("none/new.svg"), false, &[]).is_err());
        // Nobody can make a file there, not even root.
        for force in [false, true] {
            let (code, message) = check(Path::new("/proc/new.svg"), force, &[]).expect_err("none");
            assert_eq!(code, ExitCode::Failure);
            assert!(message.contains("--out /proc/new.svg: cannot be written: "), "{message}");
        }
        let all = || std::fs::read_dir(place.path()).expect("readable").count();
        let before = all();
        assert_eq!(check(&place.path().join("new.svg"), false, &[]), Ok(()));
        assert_eq!(all(), before, "nothing is left of the trial");
        assert_eq!(check(Path::new("new.svg"), false, &[]), Ok(()), "here");
    }

    #[test]
    fn a_run_is_left_as_it_is() {
        let place = place();
        let at = |name: &str| place.path().join(name);
        for inside in ["run/curve.svg", "run/new.svg", "run/none/new.svg"] {
            let (_, message) = check(&at(inside), false, &[]).expect_err("in a run");
            assert!(message.contains("which is a run directory"), "{message}");
            if inside != "run/none/new.svg" {
                assert_eq!(check(&at(inside), true, &[]), Ok(()), "{inside}");
            }
        }
        let run = at("run");
        let (_, message) =
            check(&at("run/config.toml"), true, &[("RUN_DIR", &run)]).expect_err("it was read");
        assert!(message.contains("which is read"), "{message}");
        assert!(check_outside("--run-dir", &at("run/another")).is_err());
        assert!(check_outside("--run-dir", &at("another")).is_ok());
    }

    #[test]
    fn a_directory_with_other_things_is_taken_by_force_only() {
        let place = place();
        let ours = |name: &str| name == "report.html";
        let check = |dir: &Path, force| check_directory("--out", dir, ours, Some(force));
        let none = check_directory("--out", place.path(), ours, None).expect_err("not ours");
        assert!(none.message.ends_with("; name another directory"), "{none}");
        let message = check(place.path(), false).expect_err("not ours").message;
        assert!(message.contains("holds \"empty\"") && message.contains("--force"), "{message}");
        assert!(check(place.path(), true).is_ok());
        for force in [false, true] {
            let message = check(&place.path().join("run"), force).expect_err("a run").message;
            assert!(message.contains("is a run directory"), "{message}");
        }
        let own = place.path().join("own");
        assert!(check(&own, false).is_ok(), "it is still to be made");
        std::fs::create_dir(&own).expect("made");
        std::fs::write(own.join("report.html"), "x").expect("written");
        std::fs::write(own.join(".noise.json.7.tmp"), "x").expect("written");
        assert!(check(&own, false).is_ok());
        assert!(check(&place.path().join("in.csv"), true).is_err(), "no directory");
    }

    #[test]
    fn names_end_as_what_is_written() {
        for fit in ["a.svg", "a.SVG", "a", "svg", "/dev/null", "/dev/stdout"] {
            assert!(check_ending("--out", Path::new(fit), "svg").is_ok(), "{fit}");
        }
        for wrong in ["a.png", "a.", "a.svg.gz"] {
            let error = check_ending("--out", Path::new(wrong), "svg").expect_err(wrong);
            assert_eq!(error.code, ExitCode::Usage);
            assert!(error.message.ends_with("wants a name that ends in .svg"), "{error}");
        }
    }
}
