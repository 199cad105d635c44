//! The texts of a run, which stay as they were when it began.
//!
//! Every process reads the configuration and the robot when it starts, also one that takes another's place
//! hours later. Where they were changed meanwhile, it would make other blocks than those before, and nobody
//! could tell. So the coordinator hashes both once, and its children compare what they read.

use std::io::{Error, ErrorKind, Result};
use std::path::Path;
use std::process::Command;

use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};

use crate::input;

/// Variables by which a child is told the BLAKE3 hashes of both texts.
const CONFIG: &str = "SPACEOCTOPUS_CONFIG_BLAKE3";
const ROBOT: &str = "SPACEOCTOPUS_ROBOT_BLAKE3";

/// Hashes of both texts as the run began with them.
#[derive(Debug, Clone)]
pub struct Originals {
    config: String,
    robot: String,
}

impl Originals {
    /// Of the run in `run_dir`, as they are now; an error names the file.
    pub fn read(run_dir: &RunDir) -> std::result::Result<Self, ExitError> {
        let hash = |path: &Path| {
            input::read_text(path)
                .map(|text| hash(&text))
                .map_err(|error| refusal(path, &format!("cannot be read: {error}")))
        };
        Ok(Self { config: hash(&run_dir.config())?, robot: hash(&run_dir.robot())? })
    }

    /// Refuses a run whose texts are others by now; an error names the file.
    pub fn check(&self, run_dir: &RunDir) -> std::result::Result<(), ExitError> {
        for (path, hash) in [(run_dir.config(), &self.config), (run_dir.robot(), &self.robot)] {
            original(&path, Some(hash)).map_err(|error| refusal(&path, &error.to_string()))?;
        }
        Ok(())
    }

    /// Tells a child.
    pub fn tell(&self, child: &mut Command) {
        child.env(CONFIG, &self.config).env(ROBOT, &self.robot);
    }
}

/// The configuration of the run in `run_dir`. One that is another than this process was told of is an error.
pub fn config(run_dir: &RunDir) -> Result<String> {
    original(&run_dir.config(), std::env::var(CONFIG).ok().as_deref())
}

/// The same of its robot.
pub fn robot(run_dir: &RunDir) -> Result<String> {
    original(&run_dir.robot(), std::env::var(ROBOT).ok().as_deref())
}

fn refusal(path: &Path, reason: &str) -> ExitError {
    ExitError::new(ExitCode::RunDirectory, format!("{}: {reason}", path.display()))
}

/// The text of a file that had the hash `expected`; whoever was started by hand was told of none.
fn original(path: &Path, expected: Option<&str>) -> Result<String> {
    let text = input::read_text(path)?;
    if expected.is_some_and(|expected| expected != hash(&text)) {
        let message = "it was changed since the session of the run began; put it back, or stop the run \
                       before it is changed, and `octopus resume` goes on with it";
        return Err(Error::new(ErrorKind::InvalidData, message));
    }
    Ok(text)
}

fn hash(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_that_was_changed_is_not_taken() {
        let dir = std::env::temp_dir().join(format!("process-originals-{}", std::process::id()));
        std::fs::create_dir(&dir).expect("a directory");
        let run_dir = RunDir::new(&dir);
        std::fs::write(run_dir.config(), "action_scale = 0.3").expect("writable");
        let incomplete = Originals::read(&run_dir).map(drop);
        std::fs::write(run_dir.robot(), "[base]").expect("writable");
        let originals = Originals::read(&run_dir);
        let read = |expected: Option<&str>| original(&run_dir.config(), expected);
        let told = originals.as_ref().ok().map(|originals| originals.config.as_str());
        let check = || originals.as_ref().map(|originals| originals.check(&run_dir));
        let (before, same) = (read(told), check());
        std::fs::write(run_dir.config(), "action_scale = 0.4").expect("writable");
        let (after, by_hand, other) = (read(told), read(None), check());
        let mut child = Command::new("learner");
        originals.as_ref().expect("both are there").tell(&mut child);
        let variables = child.get_envs().count();
        std::fs::remove_dir_all(&dir).expect("removable");

        let incomplete = incomplete.expect_err("there is no robot").to_string();
        assert!(incomplete.contains("robot.toml"), "{incomplete}");
        assert_eq!(before.expect("as it was"), "action_scale = 0.3");
        same.expect("both are there").expect("as they were");
        let other = other.expect("both were there").expect_err("changed").to_string();
        assert!(other.contains("config.toml: it was changed"), "{other}");
        assert!(after.expect_err("changed").to_string().contains("was changed"));
        assert_eq!(by_hand.expect("nothing to compare with"), "action_scale = 0.4");
        assert_eq!(variables, 2);
    }
}
