//! The texts of a run, which stay as they were when it began.
//!
//! Every process reads the configuration and the robot when it starts, also one that takes another's place
//! hours later. Where they were changed meanwhile, it would make other blocks than those before, and nobody
//! could tell. So the coordinator hashes both once, and its children compare what they read.
//!
//! Of the configuration the values are hashed, all of which a process takes from it: people write comments into it. The
//! robot is hashed as it is written, since `octopus resume` compares its text, too.

use std::io::{Error, ErrorKind, Result};
use std::path::Path;
use std::process::Command;

use proto::config::Config;
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
        let read = |path: &Path| {
            input::read_text(path)
                .map_err(|error| refusal(path, &format!("cannot be read: {error}")))
        };
        let config = hash_of_values(&read(&run_dir.config())?);
        Ok(Self { config, robot: hash(&read(&run_dir.robot())?) })
    }

    /// Refuses a run whose texts are others by now; an error names the file.
    pub fn check(&self, run_dir: &RunDir) -> std::result::Result<(), ExitError> {
        let check = |path: &Path, expected: &str, hash: Hash| {
            original(path, Some(expected), hash)
                .map(drop)
                .map_err(|error| refusal(path, &error.to_string()))
        };
        check(&run_dir.config(), &self.config, hash_of_values)?;
        check(&run_dir.robot(), &self.robot, hash)
    }

    /// Tells a child.
    pub fn tell(&self, child: &mut Command) {
        child.env(CONFIG, &self.config).env(ROBOT, &self.robot);
    }
}

/// The configuration of the run in `run_dir`. One that is another than this process was told of is an error.
pub fn config(run_dir: &RunDir) -> Result<String> {
    original(&run_dir.config(), std::env::var(CONFIG).ok().as_deref(), hash_of_values)
}

/// The same of its robot.
pub fn robot(run_dir: &RunDir) -> Result<String> {
    original(&run_dir.robot(), std::env::var(ROBOT).ok().as_deref(), hash)
}

fn refusal(path: &Path, reason: &str) -> ExitError {
    ExitError::new(ExitCode::RunDirectory, format!("{}: {reason}", path.display()))
}

/// How a text is hashed.
type Hash = fn(&str) -> String;

/// The text of a file that had the hash `expected`; whoever was started by hand was told of none.
fn original(path: &Path, expected: Option<&str>, hash: Hash) -> Result<String> {
    let text = input::read_text(path)?;
    if expected.is_some_and(|expected| expected != hash(&text)) {
        let message = "it was changed since the session of the run began; put it back, or stop the run \
                       before it is changed, and `octopus resume` goes on with it";
        return Err(Error::new(ErrorKind::InvalidData, message));
    }
    Ok(text)
}

/// The hash of a configuration's values, whatever else is written beside them; of a text that is none, its own.
fn hash_of_values(text: &str) -> String {
    match Config::from_resolved_toml(text, "") {
        Ok(config) => hash(&config.to_toml()),
        Err(_) => hash(text),
    }
}

fn hash(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

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
        let read = |expected: Option<&str>| original(&run_dir.config(), expected, hash_of_values);
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

    /// A word of its user's ended a run when the next process started.
    #[test]
    fn of_a_configuration_all_values_count_and_nothing_else() {
        let config = Layers::new(Preset::Tuned, None).resolve().expect("valid");
        let text = config.to_toml();
        let commented = format!("# mine\n{}# and more\n", text.replacen(" = ", "=  ", 3));
        assert_ne!(commented, text);
        assert_eq!(hash_of_values(&commented), hash_of_values(&text));
        let mut keys = 0;
        for (at, line) in text.lines().enumerate() {
            // A last place more is another value; what is out of range then is compared as it is written.
            let Some((key, number)) = line.split_once(" = ") else { continue };
            let other = match number.parse::<f64>() {
                Ok(float) if number.contains('.') => format!("{:?}", float.next_up()),
                Ok(float) => format!("{}", float + 1.0),
                Err(_) => continue,
            };
            let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
            lines[at] = format!("{key} = {other}");
            assert_ne!(hash_of_values(&lines.join("\n")), hash_of_values(&text), "{key}");
            keys += 1;
        }
        assert!(keys > 50, "{keys} keys");
    }
}
