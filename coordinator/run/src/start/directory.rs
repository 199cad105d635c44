//! Where a run lands, and that no two take the same place.

use std::path::Path;

use anyhow::Context as _;
use proto::config::Config;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use serde_json::json;
use store::lock::RunLock;
use store::provenance::{Provenance, Utc};
use store::{files, regular_files, temporary};

/// Where runs land without `--run-dir`.
pub const RUNS: &str = "runs";

/// Refuses a run directory with anything in it.
pub fn check_vacant(path: &Path) -> Result<(), ExitError> {
    let shown = path.display();
    let refuse = |message: String| Err(ExitError::new(ExitCode::RunDirectory, message));
    match std::fs::read_dir(path).map(|mut entries| entries.next().is_none()) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(error) => {
            refuse(format!("{shown}: cannot be a run directory: {error}; choose another --run-dir"))
        }
        Ok(true) => Ok(()),
        Ok(false) if RunDir::new(path).config().is_file() => refuse(format!(
            "{shown}: holds a run already; go on with it by `octopus resume {}`, or choose \
             another --run-dir",
            output::quoted(path)
        )),
        Ok(false) => refuse(format!("{shown}: is not empty; choose another --run-dir")),
    }
}

/// Refuses the directory of a new run, which this process has locked, if another run has come into it since
/// [`check_new`]: it may also have ended since.
pub fn check_still_new(run_dir: &RunDir) -> Result<(), ExitError> {
    let path = run_dir.path();
    if holds_only_what_a_start_leaves(path, true).unwrap_or(false) {
        return Ok(());
    }
    check_vacant(path)
}

/// Refuses a new run's directory with anything in it but what a start has left that was killed before it wrote the
/// configuration: nobody could go on from that.
pub fn check_new(path: &Path) -> Result<(), ExitError> {
    if is_left_by_a_start(path).unwrap_or(false) { Ok(()) } else { check_vacant(path) }
}

/// Whether a directory holds nothing but what [`create`] makes, a lock that nobody holds, and what is written under
/// that lock before the configuration.
fn is_left_by_a_start(path: &Path) -> std::io::Result<bool> {
    let run_dir = RunDir::new(path);
    let is_locked = !matches!(RunLock::holder(&run_dir.lock()), Ok(None));
    if is_locked {
        return Ok(false);
    }
    // A robot without a lock beside it is somebody's own.
    holds_only_what_a_start_leaves(path, run_dir.lock().is_file())
}

fn holds_only_what_a_start_leaves(path: &Path, was_locked: bool) -> std::io::Result<bool> {
    for entry in std::fs::read_dir(path)? {
        let entry = entry?;
        let (name, kind) = (entry.file_name(), entry.file_type()?);
        let is_left = match name.to_str() {
            Some("logs" | "checkpoints") => {
                kind.is_dir() && std::fs::read_dir(entry.path())?.next().is_none()
            }
            Some("run.lock") => kind.is_file(),
            Some("robot.toml") => kind.is_file() && was_locked,
            Some(other) => {
                let begun =
                    matches!(temporary::replaced(other), Some("robot.toml" | "config.toml"));
                begun && kind.is_file() && was_locked
            }
            None => false,
        };
        if !is_left {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Makes the directory and its folders.
pub fn create(run_dir: &RunDir) -> Result<(), ExitError> {
    for path in [run_dir.path().to_owned(), run_dir.logs(), run_dir.checkpoints()] {
        std::fs::create_dir_all(&path).map_err(|error| {
            ExitError::new(
                ExitCode::RunDirectory,
                format!("{}: cannot be created: {error}; choose another --run-dir", path.display()),
            )
        })?;
    }
    Ok(())
}

/// `<task>-<UTC time>`.
pub fn default_name(config: &Config) -> String {
    let time = Utc::now().compact();
    format!("{}-{time}", config.task.name.as_str())
}

/// Makes the directory `name` in `parent`, with a number if another run has that name: making it is what
/// tells who was first, of runs that start in the same second.
pub fn claim(parent: &Path, name: &str) -> Result<RunDir, ExitError> {
    let fail = |path: &Path, error: std::io::Error| {
        let shown = path.display();
        let message =
            format!("{shown}: cannot be created: {error}; choose another place by --run-dir");
        ExitError::new(ExitCode::RunDirectory, message)
    };
    std::fs::create_dir_all(parent).map_err(|error| fail(parent, error))?;
    let mut path = parent.join(name);
    let mut n = 1;
    loop {
        match std::fs::create_dir(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                n += 1;
                path = parent.join(format!("{name}-{n}"));
            }
            made => return made.map(|()| RunDir::new(&path)).map_err(|error| fail(&path, error)),
        }
    }
}

/// Adds a session to `provenance.json`.
pub fn record(
    run_dir: &RunDir,
    provenance: &Provenance,
    overrides: &[String],
) -> anyhow::Result<()> {
    let path = run_dir.provenance();
    let mut sessions = sessions(&path)?;
    let mut session = serde_json::to_value(provenance).context("provenance has no JSON form")?;
    session["overrides"] = json!(overrides);
    sessions.push(session);
    let text = serde_json::to_vec_pretty(&json!({ "sessions": sessions }))
        .context("provenance has no JSON form")?;
    files::replace(&path, &text)?;
    Ok(())
}

/// The session that a run had last, as far as this version can read it.
pub fn last_session(run_dir: &RunDir) -> Result<Option<Provenance>, ExitError> {
    let last = sessions(&run_dir.provenance())?.pop();
    Ok(last.and_then(|last| serde_json::from_value(last).ok()))
}

/// The sessions that a run has had.
///
/// # Errors
/// If something is there that does not say them ([`ExitCode::RunDirectory`]): what would be lost says on which processors the run's bits were made.
fn sessions(path: &Path) -> Result<Vec<serde_json::Value>, ExitError> {
    let damaged = |what: &dyn std::fmt::Display| {
        let message = format!(
            "{}: {what}; put the file back from a copy, or remove it if it may be forgotten who trained the run before",
            path.display()
        );
        ExitError::new(ExitCode::RunDirectory, message)
    };
    let bytes = match regular_files::read(path, regular_files::RECORD) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(damaged(&format_args!("cannot be read: {error}"))),
    };
    let document: serde_json::Value =
        serde_json::from_slice(&bytes).map_err(|error| damaged(&error))?;
    let sessions = document["sessions"].as_array();
    sessions.cloned().ok_or_else(|| damaged(&"`sessions` is no list"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_that_cannot_be_read_are_not_forgotten() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("provenance.json");
        assert_eq!(sessions(&path).expect("none yet"), [json!(null); 0]);
        for damage in ["", "{", "{}", "{\"sessions\": 3}"] {
            std::fs::write(&path, damage).expect("writable");
            let error = sessions(&path).expect_err(damage);
            assert_eq!(error.code, ExitCode::RunDirectory);
            assert!(error.message.contains("provenance.json: "), "{}", error.message);
        }
        std::fs::write(&path, "{\"sessions\": [{\"host\": \"a\"}]}").expect("writable");
        assert_eq!(sessions(&path).expect("one"), [json!({ "host": "a" })]);
    }

    #[test]
    fn the_last_session_is_read_as_it_was_recorded() {
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path());
        assert_eq!(last_session(&run_dir).expect("none"), None);
        let now = Provenance::gather();
        let before = Provenance { host: "before".to_owned(), ..now.clone() };
        for session in [&before, &now] {
            record(&run_dir, session, &["run.workers".to_owned()]).expect("writable");
        }
        assert_eq!(last_session(&run_dir).expect("readable"), Some(now));
        let earlier = r#"{"sessions": [{"host": "a"}]}"#;
        std::fs::write(run_dir.provenance(), earlier).expect("writable");
        assert_eq!(last_session(&run_dir).expect("readable"), None);
    }

    #[test]
    fn what_a_killed_start_has_left_is_in_no_ones_way() {
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path().join("run"));
        let check = || check_new(run_dir.path());
        let write = |name: &str| std::fs::write(run_dir.path().join(name), "a part");
        check().expect("nothing is there");
        create(&run_dir).expect("writable");
        check().expect("killed before it had the lock");
        write("robot.toml").expect("writable");
        check().expect_err("nobody has locked it: it is somebody's own");
        std::fs::remove_file(run_dir.robot()).expect("there");

        let lock = RunLock::acquire(&run_dir.lock(), "octopus-0-12345678").expect("free");
        check().expect_err("it starts just now");
        drop(lock);
        write(".robot.toml.77.tmp").expect("writable");
        write("robot.toml").expect("writable");
        write(".config.toml.77.tmp").expect("writable");
        check().expect("killed while it wrote the configuration");
        check_vacant(run_dir.path()).expect_err("there is something");

        for name in ["logs/learner.log", "checkpoints/.lock", "thesis.tex", ".thesis.tex.77.tmp"] {
            write(name).expect("writable");
            let error = check().expect_err(name);
            assert_eq!(error.code, ExitCode::RunDirectory);
            assert!(error.message.contains("is not empty"), "{name}: {error}");
            std::fs::remove_file(run_dir.path().join(name)).expect("there");
        }
        write("config.toml").expect("writable");
        let error = check().expect_err("a run").to_string();
        assert!(error.contains("octopus resume"), "{error}");
    }

    /// The second one wrote its configuration over that of the first.
    #[test]
    fn a_run_that_came_into_the_directory_meanwhile_is_left_alone() {
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path().join("run"));
        check_new(run_dir.path()).expect("nothing is there");
        create(&run_dir).expect("writable");
        let lock = RunLock::acquire(&run_dir.lock(), "octopus-0-12345678").expect("free");
        check_still_new(&run_dir).expect("nobody else came");
        std::fs::write(run_dir.robot(), "a part").expect("writable");
        check_still_new(&run_dir).expect("a start that was killed");
        std::fs::write(run_dir.config(), "").expect("writable");
        let error = check_still_new(&run_dir).expect_err("a run");
        assert_eq!(error.code, ExitCode::RunDirectory);
        assert!(error.message.contains("holds a run already"), "{error}");
        drop(lock);
    }

    #[test]
    fn runs_that_start_in_the_same_second_get_directories_of_their_own() {
        let dir = tempfile::tempdir().expect("tempdir");
        let parent = dir.path().join("runs");
        let names: std::collections::BTreeSet<_> = std::thread::scope(|scope| {
            let starts: Vec<_> = (0..8).map(|_| scope.spawn(|| claim(&parent, "x"))).collect();
            let claimed = starts.into_iter().map(|start| start.join().expect("no panic"));
            claimed.map(|run_dir| run_dir.expect("writable").path().to_owned()).collect()
        });
        let expected = ["x", "x-2", "x-3", "x-4", "x-5", "x-6", "x-7", "x-8"];
        assert_eq!(names, expected.map(|name| parent.join(name)).into());
    }
}
