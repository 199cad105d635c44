//! The programs of a run stay what they are while it goes on.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use proto::{ExitCode, ExitError};
use store::stamp::Stamp;

/// The programs that a run has started, as they were then. Another build may compute other bits, and a run
/// that has begun with one would end with the other.
#[derive(Debug, Default)]
pub(super) struct StartedPrograms(BTreeMap<PathBuf, (Stamp, Option<blake3::Hash>)>);

impl StartedPrograms {
    /// Refuses a program that is another one than this run has started before. What cannot be looked at
    /// cannot be started either, and whoever starts it says why.
    pub(super) fn check(&mut self, program: &Path) -> Result<(), ExitError> {
        let Ok(there) = program.metadata() else { return Ok(()) };
        let stamp = Stamp::of(&there);
        let before = self.0.get(program);
        if before.is_some_and(|(before, _)| *before == stamp) {
            return Ok(());
        }
        let hash = hash(program).ok();
        // Who installs the same once more changes nothing.
        if before.is_some_and(|(_, before)| before.is_none() || *before != hash) {
            let message = format!(
                "{}: was changed since the session of the run began, and another build may compute other \
                 bits; put it back, or go on with it by `octopus resume`",
                program.display()
            );
            return Err(ExitError::new(ExitCode::Environment, message));
        }
        self.0.insert(program.to_owned(), (stamp, hash));
        Ok(())
    }
}

fn hash(program: &Path) -> std::io::Result<blake3::Hash> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(File::open(program)?)?;
    Ok(hasher.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_is_started_again_only_if_it_is_the_same() {
        let dir = tempfile::tempdir().expect("tempdir");
        let program = dir.path().join("sim-worker");
        let mut started = StartedPrograms::default();
        started.check(&program).expect("whoever starts it says that it is not there");
        let install = |text: &str| {
            let new = dir.path().join("new");
            std::fs::write(&new, text).expect("writable");
            std::fs::rename(&new, &program).expect("renames");
        };
        install("one build");
        started.check(&program).expect("the first one");
        started.check(&program).expect("it is still there");
        install("one build");
        started.check(&program).expect("the same once more");
        install("next build");
        let error = started.check(&program).expect_err("another one");
        assert_eq!(error.code, ExitCode::Environment);
        assert!(error.message.contains("sim-worker: was changed"), "{error}");
    }
}
