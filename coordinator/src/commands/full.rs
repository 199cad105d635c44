//! What to do when a run ends because its disk is full.

use proto::{ExitCode, ExitError};
use proto::run_dir::RunDir;
use rustix::io::Errno;

use super::exit_code;
use crate::causes;

/// Adds to an error of a run that there was no room what makes the run go on. All that is committed is whole.
pub(super) fn explain(error: anyhow::Error, run_dir: &RunDir) -> anyhow::Error {
    let told = causes::told(&error);
    // Errors of runs are words already; the system's own are in them as they are everywhere.
    let full = [Errno::NOSPC, Errno::DQUOT, Errno::FBIG]
        .map(|errno| std::io::Error::from(errno).to_string())
        .iter()
        .any(|reason| told.contains(reason));
    if !full {
        return error;
    }
    let shown = run_dir.path().display();
    let message = format!("{told}; make room, then `octopus resume {shown}` goes on");
    let code = match exit_code(&error) {
        // The system's own error, of a file of the run.
        ExitCode::Failure => ExitCode::RunDirectory,
        code => code,
    };
    ExitError::new(code, message).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_names_the_command_that_goes_on() {
        let of = |errno: Errno| {
            let reason = std::io::Error::from(errno);
            let message = format!("metrics cannot be written: metrics.jsonl: {reason}");
            let error = ExitError::new(ExitCode::RunDirectory, message).into();
            explain(error, &RunDir::new("runs/a"))
        };
        let told = causes::told(&of(Errno::NOSPC));
        assert!(told.ends_with("; make room, then `octopus resume runs/a` goes on"), "{told}");
        assert_eq!(exit_code(&of(Errno::NOSPC)), ExitCode::RunDirectory);
        assert!(!causes::told(&of(Errno::ACCESS)).contains("resume"));
        let plain = anyhow::Error::from(std::io::Error::from(Errno::DQUOT));
        let error = explain(plain, &RunDir::new("runs/a"));
        assert_eq!(exit_code(&error), ExitCode::RunDirectory);
    }
}
