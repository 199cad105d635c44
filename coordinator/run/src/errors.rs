//! The words and the exit code that an error ends a program with.

use proto::run_dir::RunDir;
use proto::{ConfigError, ExitCode, ExitError};
use rustix::io::Errno;
use simulator::robot::RobotError;
use store::checkpoint::CheckpointError;
use store::lock::LockError;

/// An error and its causes, each said once. Most of our errors name the system's reason in their own words,
/// and have it as their cause, too.
pub fn told(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |mut told, cause| {
        let cause = cause.to_string();
        let cause = cause.trim_end();
        if told.is_empty() {
            told.push_str(cause);
        } else if !told.contains(cause) {
            told.push_str(": ");
            told.push_str(cause);
        }
        told
    })
}

/// The exit code that an error ends the program with: that of the innermost cause that has one.
pub fn exit_code(error: &anyhow::Error) -> ExitCode {
    let code = |cause: &(dyn std::error::Error + 'static)| {
        if let Some(error) = cause.downcast_ref::<ExitError>() {
            return Some(error.code);
        }
        if cause.is::<ConfigError>() || cause.is::<RobotError>() {
            return Some(ExitCode::BadInput);
        }
        (cause.is::<CheckpointError>() || cause.is::<LockError>()).then_some(ExitCode::RunDirectory)
    };
    error.chain().find_map(code).unwrap_or(ExitCode::Failure)
}

/// Adds to an error of a run that there was no room what makes the run go on. All that is committed is whole.
pub fn name_what_goes_on(error: anyhow::Error, run_dir: &RunDir) -> anyhow::Error {
    let run = output::quoted(run_dir.path());
    name_what_follows_room(error, &format!("`octopus resume {run}` goes on"))
}

/// Adds to an error that there was no room what does the rest when there is.
pub fn name_what_follows_room(error: anyhow::Error, then: &str) -> anyhow::Error {
    let told = told(&error);
    // Errors of runs are words already; the system's own are in them as they are everywhere.
    let full = [Errno::NOSPC, Errno::DQUOT, Errno::FBIG]
        .map(|errno| std::io::Error::from(errno).to_string())
        .iter()
        .any(|reason| told.contains(reason));
    if !full {
        return error;
    }
    let message = format!("{told}; make room, then {then}");
    let code = match exit_code(&error) {
        // The system's own error, of a file of the run.
        ExitCode::Failure => ExitCode::RunDirectory,
        code => code,
    };
    ExitError::new(code, message).into()
}

#[cfg(test)]
mod tests {
    use std::io::{Error, ErrorKind};

    use anyhow::Context as _;

    use super::*;

    #[test]
    fn no_cause_is_said_twice() {
        let source = Error::from(ErrorKind::PermissionDenied);
        let error = CheckpointError::Io { path: "state".into(), action: "read", source };
        let error = Err::<(), _>(error).context("runs/a").expect_err("an error");
        assert_eq!(told(&error), "runs/a: state: cannot read: permission denied");
    }

    #[test]
    fn a_cause_that_is_not_named_is_added() {
        let error = Err::<(), _>(Error::from(ErrorKind::NotFound)).context("in.csv\n");
        assert_eq!(told(&error.expect_err("an error")), "in.csv: entity not found");
    }

    #[test]
    fn a_full_disk_names_the_command_that_goes_on() {
        let of = |errno: Errno| {
            let reason = std::io::Error::from(errno);
            let message = format!("metrics cannot be written: metrics.jsonl: {reason}");
            let error = ExitError::new(ExitCode::RunDirectory, message).into();
            name_what_goes_on(error, &RunDir::new("runs/a"))
        };
        let text = told(&of(Errno::NOSPC));
        assert!(text.ends_with("; make room, then `octopus resume runs/a` goes on"), "{text}");
        assert_eq!(exit_code(&of(Errno::NOSPC)), ExitCode::RunDirectory);
        assert!(!told(&of(Errno::ACCESS)).contains("resume"));
        let plain = anyhow::Error::from(std::io::Error::from(Errno::DQUOT));
        let error = name_what_goes_on(plain, &RunDir::new("my runs/a"));
        assert_eq!(exit_code(&error), ExitCode::RunDirectory);
        assert!(told(&error).contains("`octopus resume 'my runs/a'` goes on"), "{error}");
    }
}
