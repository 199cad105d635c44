//! What a run left behind that can be compared: digests, configuration, robot, provenance.

use std::path::{Path, PathBuf};

use proto::config::Precision;
use proto::run_dir::RunDir;
use proto::{Digest, ExitCode, ExitError};
use run::precision;
use serde::Deserialize;
use serde_json::Value;
use store::budgets::{Budget, Budgets};
use store::checkpoint::CheckpointStore;
use store::regular_files;
use store::run_files::{read_text, run_directory};

/// What a line of `metrics.jsonl` says about the training state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[expect(clippy::struct_field_names, reason = "the keys of the file")]
pub(super) struct Iteration {
    /// The iteration, from 0.
    pub(super) iteration: u64,
    /// Env-steps trained on, this iteration included.
    pub(super) env_steps: u64,
    /// Digest of the training state after it.
    pub(super) digest: Digest,
}

/// A run, read whole and strictly: what cannot be compared is an error, never left out.
#[derive(Debug)]
pub struct Record {
    /// Its directory.
    pub(super) path: PathBuf,
    /// Its iterations, in order.
    pub(super) iterations: Vec<Iteration>,
    /// Its configuration, untyped: another version may have had other keys. Where one has left `run.precision` at `auto`,
    /// it is what the checkpoints say, if there are any.
    pub(super) config: toml::Table,
    /// Its robot.
    pub(super) robot: String,
    /// Where its sessions ran.
    pub(super) sessions: Vec<Value>,
    /// Over which budgets its schedules ran, if it says so.
    pub(super) budgets: Vec<Budget>,
}

impl Record {
    /// Whether both are of one directory, by whatever ways.
    pub fn is_of_the_directory_of(&self, other: &Self) -> bool {
        let place = |record: &Self| record.path.canonicalize().ok();
        place(self).is_some_and(|here| place(other) == Some(here))
    }

    /// Reads the run at `path`.
    pub fn read(path: &Path) -> Result<Self, ExitError> {
        let run_dir = run_directory(path)?;
        let iterations = read_iterations(&run_dir.metrics_jsonl(), 0)?;
        if iterations.is_empty() {
            let what = "holds no iteration yet; there is nothing to compare";
            return Err(damaged(&run_dir.metrics_jsonl(), what));
        }
        let mut config: toml::Table = read_text(&run_dir.config())?
            .parse()
            .map_err(|error| damaged(&run_dir.config(), &format!("not valid TOML: {error}")))?;
        if !config.contains_key("run") {
            return Err(damaged(&run_dir.config(), "key `run` is missing"));
        }
        let provenance: Value = serde_json::from_str(&read_text(&run_dir.provenance())?)
            .map_err(|error| damaged(&run_dir.provenance(), &format!("not valid JSON: {error}")))?;
        let sessions = provenance["sessions"]
            .as_array()
            .cloned()
            .ok_or_else(|| damaged(&run_dir.provenance(), "has no list `sessions`"))?;
        if is_undecided(&config)
            && let Some(precision) = trained_with(&run_dir)
            && let Some(run) = config.get_mut("run").and_then(toml::Value::as_table_mut)
        {
            run.insert("precision".to_owned(), precision::name(precision).into());
        }
        let robot = read_text(&run_dir.robot())?;
        let budgets = Budgets::read(&run_dir)?.history().to_vec();
        Ok(Self { path: path.to_owned(), iterations, config, robot, sessions, budgets })
    }

    /// The budgets of the first `iterations` iterations. A run from before they were written down is taken
    /// to have had the one of its configuration.
    pub(super) fn budgets_until(&self, iterations: u64) -> Vec<Budget> {
        let only = || {
            let run = self.config.get("run");
            let env_steps = run.and_then(|run| run.get("env_steps")?.as_integer()).unwrap_or(0);
            vec![Budget { from: 0, env_steps: env_steps.unsigned_abs() }]
        };
        let mut budgets = if self.budgets.is_empty() { only() } else { self.budgets.clone() };
        budgets.retain(|budget| budget.from < iterations);
        budgets
    }

    /// What earlier versions wrote of changes of the budget, where nothing says when they were made.
    pub(super) fn undated_budgets(&self) -> Vec<&str> {
        let changes = self.sessions.iter().filter_map(|session| session["overrides"].as_array());
        let changes = changes.flatten().filter_map(Value::as_str);
        changes
            .filter(|change| self.budgets.is_empty() && change.starts_with("run.env_steps "))
            .collect()
    }

    /// Whether nothing says which arithmetic an earlier version chose for it.
    pub(super) fn is_undecided(&self) -> bool {
        is_undecided(&self.config)
    }
}

fn is_undecided(config: &toml::Table) -> bool {
    config.get("run").and_then(|run| run.get("precision")?.as_str()) == Some("auto")
}

/// What the newest whole training state of the run's own was trained with.
fn trained_with(run_dir: &RunDir) -> Option<Precision> {
    let store = CheckpointStore::new(run_dir.checkpoints());
    let [own, _] = store.by_ownership().ok()?;
    own.into_iter()
        .filter_map(|dir| store.load(&dir).ok())
        .filter(|checkpoint| checkpoint.manifest.has_state())
        .find_map(|checkpoint| checkpoint.precision().ok())
}

/// The iterations of a `metrics.jsonl`, which follow each other from `first` on. A last line
/// without an end is being written, or was cut by a crash, and is no iteration yet.
pub(super) fn read_iterations(path: &Path, first: u64) -> Result<Vec<Iteration>, ExitError> {
    let text = regular_files::read_text(path, regular_files::RECORD)
        .map_err(|error| damaged(path, &format!("cannot be read: {error}")))?;
    let lines = text.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
    lines
        .zip(first..)
        .enumerate()
        .map(|(index, (line, expected))| {
            let number = index + 1;
            let found: Iteration = serde_json::from_str(line).map_err(|error| {
                let cure = "put the file back from a copy";
                damaged(path, &format!("line {number} is no iteration: {error}; {cure}"))
            })?;
            if found.iteration != expected {
                let what =
                    format!("line {number}: iteration {} instead of {expected}", found.iteration);
                return Err(damaged(path, &what));
            }
            Ok(found)
        })
        .collect()
}

/// Something that belongs to a run is not as it should be.
pub(super) fn damaged(path: &Path, what: &str) -> ExitError {
    ExitError::new(ExitCode::RunDirectory, format!("{}: {what}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DIGEST: &str = "000102030405060708090a0b0c0d0e0f";

    fn read(text: &str) -> Result<Vec<Iteration>, String> {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("metrics.jsonl");
        std::fs::write(&path, text).expect("writable");
        read_iterations(&path, 0).map_err(|error| error.to_string())
    }

    fn line(iteration: u64) -> String {
        format!("{{\"iteration\": {iteration}, \"env_steps\": 8, \"digest\": \"{DIGEST}\"}}\n")
    }

    #[test]
    fn a_line_that_is_being_written_is_no_iteration_and_no_damage() {
        let whole = format!("{}{}", line(0), line(1));
        assert_eq!(read(&whole).map(|lines| lines.len()), Ok(2));
        assert_eq!(read(&whole[..whole.len() - 5]).map(|lines| lines.len()), Ok(1));
    }

    #[test]
    fn a_record_of_a_long_training_is_read() {
        let lines = 4 * regular_files::TEXT / line(0).len() as u64;
        let text: String = (0..lines).map(line).collect();
        assert_eq!(read(&text).map(|lines| lines.len() as u64), Ok(lines));
    }

    #[test]
    fn a_damaged_line_is_named_and_never_ends_the_comparison_quietly() {
        let error = read(&format!("{}rubbish\n{}", line(0), line(2))).expect_err("damaged");
        assert!(error.contains("metrics.jsonl: line 2 is no iteration: "), "{error}");
        let error = read(&format!("{}{}", line(0), line(2))).expect_err("a gap");
        assert!(error.contains("line 2: iteration 2 instead of 1"), "{error}");
        let error = read(&line(0).replace("0f\"", "xx\"")).expect_err("no digest");
        assert!(error.contains("32 hexadecimal digits"), "{error}");
    }
}
