//! `evaluations.jsonl`: what evaluations on held-out goals say, one a line.

use std::path::Path;

use proto::run_dir::RunDir;
use serde::Serialize;
use serde_json::Value;
use store::jsonl::{self, JsonLines};

use super::row::Row;
use crate::selection::{MeanErrors, Means};

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

/// What a line says of a policy, and when.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOut {
    /// Env-steps that the policy was trained on.
    pub env_steps: f64,
    /// Time since the run began (s).
    pub wall_s: f64,
    /// Its errors.
    pub errors: Means,
}

impl Row for HeldOut {
    const NAMES: [&'static str; 8] = [
        "env_steps",
        "wall_s",
        "tail_position",
        "tail_orientation",
        "tail_base",
        "min_position",
        "min_orientation",
        "min_base",
    ];

    fn numbers(&self) -> [f64; 8] {
        let Self { env_steps, wall_s, errors: Means { tail, min } } = *self;
        let ([a, b, c], [d, e, f]) = (tail.numbers(), min.numbers());
        [env_steps, wall_s, a, b, c, d, e, f]
    }

    fn from_numbers([env_steps, wall_s, a, b, c, d, e, f]: [f64; 8]) -> Self {
        let of =
            |[position, orientation, base]: [f64; 3]| MeanErrors { position, orientation, base };
        Self { env_steps, wall_s, errors: Means { tail: of([a, b, c]), min: of([d, e, f]) } }
    }
}

/// Reads an `evaluations.jsonl`; lines with a number that is not finite are left out.
pub fn read(path: &Path) -> anyhow::Result<Vec<HeldOut>> {
    let errors = |of: &Value| {
        Some(MeanErrors {
            position: of["position"].as_f64()?,
            orientation: of["orientation"].as_f64()?,
            base: of["base"].as_f64()?,
        })
    };
    let held_out = |line: &Value| {
        let (tail, min) = (errors(&line["errors"]["tail"])?, errors(&line["errors"]["min"])?);
        let (env_steps, wall_s) = (line["env_steps"].as_f64()?, line["wall_s"].as_f64()?);
        Some(HeldOut { env_steps, wall_s, errors: Means { tail, min } })
    };
    Ok(jsonl::read(path)?.iter().filter_map(|(_, line)| held_out(line)).collect())
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
