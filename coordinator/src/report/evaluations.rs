//! `evaluations.jsonl`: what evaluations on held-out goals say, one a line.

use proto::run_dir::RunDir;
use serde::Serialize;

use super::jsonl::JsonLines;
use crate::selection::Means;

/// What an evaluation says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluated {
    /// Iterations that the policy was trained on.
    pub iteration: u64,
    /// The same in env-steps.
    pub env_steps: u64,
    /// The smaller, the better.
    pub score: f64,
    /// Goals.
    pub episodes: u64,
    /// Control steps of an episode.
    pub steps: u64,
    /// Means over episodes.
    pub errors: Means,
}

/// A line.
#[derive(Debug, Serialize)]
struct Line<'a> {
    #[serde(flatten)]
    evaluated: &'a Evaluated,
    /// Time since the run began (s).
    wall_s: f64,
}

/// The open file.
#[derive(Debug)]
pub(super) struct Evaluations {
    lines: JsonLines,
    /// Iteration of the last line.
    last: Option<u64>,
}

impl Evaluations {
    /// Opens the file, with the lines of policies that were trained on at most `iterations`.
    pub(super) fn open(run_dir: &RunDir, iterations: u64) -> anyhow::Result<Self> {
        let (lines, last) = JsonLines::open(&run_dir.evaluations(), iterations + 1)?;
        Ok(Self { lines, last: last.and_then(|line| line["iteration"].as_u64()) })
    }

    /// Appends a line, unless this policy has one: the last of a run may be evaluated twice, by plan and at the
    /// end, and says the same both times. Returns whether it did.
    pub(super) fn append(&mut self, evaluated: &Evaluated, wall_s: f64) -> anyhow::Result<bool> {
        let is_new = self.last.is_none_or(|last| evaluated.iteration > last);
        if is_new {
            self.lines.append(&Line { evaluated, wall_s })?;
            self.last = Some(evaluated.iteration);
        }
        Ok(is_new)
    }

    /// Makes the lines durable.
    pub(super) fn sync(&self) -> anyhow::Result<()> {
        self.lines.sync()
    }
}
