//! `budgets.json`: over which budget the schedules of a run's iterations ran.
//!
//! Another budget is another course of a learning rate that falls over it, so what iterations ended
//! with under one says nothing about another. `config.toml` holds the budget that is wanted, this file
//! the one that the iterations so far were made with. It is written only after everything that a new
//! budget makes void is gone, so whatever a kill leaves in between, the next resume finds the two
//! different and does the same again. The same tells a budget that was changed by hand.

use std::path::{Path, PathBuf};

use proto::config::{Config, Schedule};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};

use crate::{files, regular_files};

/// Name of the file.
const BUDGETS: &str = "budgets.json";

/// A budget, and the first iteration under it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// The iteration.
    pub from: u64,
    /// `run.env_steps`.
    pub env_steps: u64,
}

/// The content of the file.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    /// In the order of their iterations.
    budgets: Vec<Budget>,
}

/// The budgets of a run.
#[derive(Debug)]
pub struct Budgets {
    path: PathBuf,
    content: Content,
}

impl Budgets {
    /// Reads those of a run; a run from before there was the file has none.
    pub fn read(run_dir: &RunDir) -> Result<Self, ExitError> {
        let path = run_dir.path().join(BUDGETS);
        let refuse = |what: String| {
            ExitError::new(
                ExitCode::RunDirectory,
                format!(
                    "{}: {what}; without the file the run goes on, as if its budget had never been \
                     changed",
                    path.display()
                ),
            )
        };
        let content: Content = match regular_files::read(&path, regular_files::TEXT) {
            Ok(bytes) => serde_json::from_slice(&bytes)
                .map_err(|error| refuse(format!("cannot be understood: {error}")))?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Content::default(),
            Err(error) => return Err(refuse(format!("cannot be read: {error}"))),
        };
        let from = || content.budgets.iter().map(|budget| budget.from);
        let ascends = from().zip(from().skip(1)).all(|(one, next)| one < next);
        if from().next().is_some_and(|first| first != 0) || !ascends {
            return Err(refuse("was changed: its iterations do not ascend from 0".to_owned()));
        }
        Ok(Self { path, content })
    }

    /// Where they were read.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All of them, in the order of their iterations; none of a run from before there was the file.
    pub fn history(&self) -> &[Budget] {
        &self.content.budgets
    }

    /// The budget of the newest iterations, if it is known.
    pub fn last(&self) -> Option<Budget> {
        self.content.budgets.last().copied()
    }

    /// Whether iterations from `keep` on, trained again under `config`, end as they did before.
    pub fn repeat(&self, config: &Config, keep: u64) -> bool {
        let same = |last: Budget| last.env_steps == config.run.env_steps && keep >= last.from;
        !matters(config) || self.last().is_none_or(same)
    }

    /// Writes down that iterations from `from` on are made under this budget. What was made of them
    /// under another must be gone.
    pub fn begin(&mut self, from: u64, env_steps: u64) -> Result<(), ExitError> {
        let budgets = &mut self.content.budgets;
        let before = budgets.clone();
        budgets.retain(|budget| budget.from < from);
        if budgets.last().is_none_or(|last| last.env_steps != env_steps) {
            budgets.push(Budget { from, env_steps });
        }
        if *budgets == before {
            return Ok(());
        }
        let mut text = serde_json::to_vec(&self.content).expect("numbers have a JSON form");
        text.push(b'\n');
        files::replace(&self.path, &text)
    }
}

/// Whether what is learned depends on the budget.
pub fn matters(config: &Config) -> bool {
    config.optimizer.schedule != Schedule::Constant
}
