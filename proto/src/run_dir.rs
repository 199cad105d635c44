//! The files of a run directory.
//!
//! ```text
//! runs/trajectory-20260101-120000/
//!   config.toml        resolved configuration; every process reads it
//!   robot.toml         the robot's description; every worker reads it
//!   provenance.json    version, processor, threads, command line, start time
//!   metrics.jsonl      one line an iteration
//!   metrics.csv        the same numbers as a table
//!   evaluations.jsonl  one line an evaluation on held-out goals
//!   events/            the same numbers for TensorBoard
//!   curve.svg          the learning curve
//!   logs/              standard error of the learner and each worker
//!   checkpoints/       one directory a checkpoint
//!   failures/          blocks that could not be made, if there are any: environment and policy
//!   promised.jsonl     digests of iterations that are being trained on again, until they are passed
//!   budgets.json       over which budgets the schedules of its iterations ran
//!   evaluation.json    the errors at the end, unless `--no-eval` leaves them out
//!   http.token         the token of the run's HTTP service; only its user reads it
//!   run.lock           held by the coordinator while the run is alive
//! ```

use std::path::{Path, PathBuf};

/// Paths inside a run directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunDir(PathBuf);

macro_rules! paths {
    ($($(#[$doc:meta])* $method:ident = $name:literal;)*) => {
        $($(#[$doc])*
        pub fn $method(&self) -> PathBuf {
            self.0.join($name)
        })*
    };
}

impl RunDir {
    /// Names the directory; touches nothing.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// The directory itself.
    pub fn path(&self) -> &Path {
        &self.0
    }

    paths! {
        /// The resolved configuration.
        config = "config.toml";
        /// The robot's description.
        robot = "robot.toml";
        /// Version, processor, command line.
        provenance = "provenance.json";
        /// One JSON object an iteration.
        metrics_jsonl = "metrics.jsonl";
        /// The same as comma-separated values.
        metrics_csv = "metrics.csv";
        /// One JSON object an evaluation on held-out goals.
        evaluations = "evaluations.jsonl";
        /// Digests with which iterations to come must end.
        promised = "promised.jsonl";
        /// TensorBoard's event files.
        events = "events";
        /// The learning curve.
        curve = "curve.svg";
        /// Standard error of the children.
        logs = "logs";
        /// Checkpoints.
        checkpoints = "checkpoints";
        /// Blocks that could not be made, one directory each.
        failures = "failures";
        /// The lock that a live run holds.
        lock = "run.lock";
    }
}
